"""`hardcase browse`: parses, calls; the work is flows/browse/browsing.py."""

from typing import TYPE_CHECKING, Annotated, cast

import typer

from pipeline.errors import unknown

if TYPE_CHECKING:
    from flows.browse.making import Beside

BESIDE = ("variants", "policies")


def browse(
    what: Annotated[
        list[str] | None,
        typer.Argument(metavar="[VERSION|EPISODE|FIELD=VALUE...]", help="What to look at. [default: everything]"),
    ] = None,
    beside: Annotated[
        str | None, typer.Option(help="variants, or policies: champion and candidate; on one time line.")
    ] = None,
    policy: Annotated[
        str | None, typer.Option(help="Lay over each episode what this policy would do: champion, or an id.")
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Serve the viewer to a browser of this machine.")] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of --web. [default: a free one]")] = 0,
    limit: Annotated[int, typer.Option(min=1, help="Episodes at most, the newest.")] = 500,
    json: Annotated[bool, typer.Option("--json", help="Print the address as JSON once it can be opened.")] = False,
) -> None:
    """Look at episodes in Rerun: robot, cameras, joints, phases, rewards; a table to sort, filter and click.

    Example: hardcase browse outcome=failure family=dropped generation=2 --web
    """
    if beside is not None and beside not in BESIDE:
        raise unknown("beside", beside, BESIDE)

    from flows.browse.browsing import BrowseOrder
    from flows.browse.browsing import browse as show
    from pipeline.store import store_root

    show(BrowseOrder(words=tuple(what or ()), beside=cast("Beside | None", beside), policy=policy, web=web, port=port,
                     limit=limit, as_json=json), store_root())
