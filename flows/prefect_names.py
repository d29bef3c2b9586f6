"""A shim: lets `prefect deployment run closed-loop` work without the flow's name and a slash.

Prefect 3.8 refuses a deployment name without a slash inside its own client.
This plugin (entry point group `prefect.plugins`, switched on in pyproject.toml)
replaces one method of that client by one that completes the name first. It
patches what is not its own, so it acts only on the versions it was tested
with, and does nothing on any other. docs/prefect.md tells users so.
"""

from collections.abc import Callable, Coroutine
from functools import wraps
from typing import TYPE_CHECKING, Any

from prefect.plugins import HookContext, SetupResult, register_hook

if TYPE_CHECKING:
    from prefect.client.orchestration import PrefectClient

TESTED = "3.8."
"""Beginning of the Prefect versions whose client was looked at and tested."""


@register_hook
def setup_environment(*, ctx: HookContext) -> SetupResult | None:
    """Prefect calls this when it is imported; sets no variables, only teaches the client short names."""
    if ctx.prefect_version.startswith(TESTED):
        from prefect.client.orchestration import PrefectClient

        PrefectClient.read_deployment_by_name = _completing(  # pyright: ignore[reportAttributeAccessIssue]
            PrefectClient.read_deployment_by_name
        )
    return None


def _completing(original: Callable[..., Coroutine[Any, Any, Any]]) -> Callable[..., Coroutine[Any, Any, Any]]:
    """The method as it was, after the name was completed; wrapped once, however often the hook runs."""
    if getattr(original, "completes_names", False):
        return original

    @wraps(original)
    async def read_deployment_by_name(self: "PrefectClient", name: str) -> Any:
        return await original(self, name if "/" in name else await complete(self, name))

    read_deployment_by_name.__dict__["completes_names"] = True
    return read_deployment_by_name


async def complete(client: "PrefectClient", name: str) -> str:
    """FLOW/NAME of the deployment called `name`; `name` as it is if there is none, or no single best one.

    Of several, the one whose flow has the same name is meant.
    """
    from prefect.client.schemas.filters import DeploymentFilter, DeploymentFilterName

    named = DeploymentFilter(name=DeploymentFilterName(any_=[name]))
    found = [
        f"{(await client.read_flow(deployment.flow_id)).name}/{deployment.name}"
        for deployment in await client.read_deployments(deployment_filter=named)
    ]
    if f"{name}/{name}" in found:
        return f"{name}/{name}"
    return found[0] if len(found) == 1 else name
