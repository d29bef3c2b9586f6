"""What re-rendered appearance is worth to a policy that sees: success on held-out twins, with and without."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from flows.run.opening import FIRST_HELD_OUT_TWIN
from flows.run.steps import Steps, open_run
from flows.studies.measured import write_json
from flows.studies.study import turn
from pipeline.errors import ConfigError
from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.recipes import load_recipe
from pipeline.simulation.appearance import NOMINAL
from pipeline.statistics import mcnemar, wilson
from pipeline.store import store_root
from schemas.recipe import Recipe

ARMS: Mapping[str, bool] = {"re-rendered": True, "as it was": False}
"""Arm -> whether the cameras see each variant under a look of its own. Starts, physics and states are the same."""


class Still:
    """The control beside everything: a robot that never moves its hand and keeps it open."""

    def reset(self, n: int) -> None:
        """Nothing is remembered."""

    def act(self, observation: Observation, ids: Ids) -> Array:
        """No motion, fingers as they were commanded."""
        return np.column_stack([np.zeros((len(ids), 4)), observation.state[:, 15]])

    def memory(self, ids: Ids) -> Array:
        """None."""
        return np.zeros((len(ids), 0))


def run_act_study(*, seeds: int, recipe: str, json: Path | None, first: int = 0) -> dict[str, Any]:
    """Train both arms for every seed, let both sit the same exam, print the table, and hand back everything.

    Args:
        seeds: how many; seed k has twin 100 + k, data seed k and training seed 1000 k.
        recipe: name or path of a recipe with a camera.
        json: where to write all of it.
        first: number of the first seed.

    Raises:
        ConfigError: the recipe renders no camera.
    """
    loaded = load_recipe(recipe)
    if not any(camera.rendered for camera in loaded.dataset.cameras.values()):
        raise ConfigError(f"recipe {recipe!r} renders no camera", where="--recipe", mend="use --recipe act")
    folder, console = store_root() / "study" / Path(recipe).stem, Console(stderr=True)
    folder.mkdir(parents=True, exist_ok=True)
    found: list[dict[str, Any]] = []
    for seed in range(first, first + seeds):
        found.append(_seed(loaded, seed, folder, console))
        console.print(f"seed {seed} finished")
    pooled = _pooled(found)
    Console().print(_table(found, pooled))
    everything = {"recipe": loaded.name, "seeds": found, "pooled": pooled}
    write_json(json, everything)
    return everything


def _seed(recipe: Recipe, seed: int, folder: Path, console: Console) -> dict[str, Any]:
    """Generation 0 of both arms, to their exam."""
    arms: dict[str, Any] = {}
    for name, appearance in ARMS.items():
        augment = recipe.augment.model_copy(update={"appearance": appearance})
        alone = recipe.model_copy(update={"augment": augment, "generations": 0, "threads": 1})
        twin = FIRST_HELD_OUT_TWIN + seed
        with open_run(folder / f"store-{seed}-{name.replace(' ', '-')}", alone, seed=seed, twin=twin,
                      control=False) as steps:
            turn(steps, 0)
            arms[name] = _read(steps, alone, seed, twin)
        console.print(f"seed {seed}, {name}: {sum(map(int, arms[name]['bits']))} of {len(arms[name]['bits'])}")
    return {"seed": seed, "twin": FIRST_HELD_OUT_TWIN + seed, "arms": arms}


def _read(steps: Steps, recipe: Recipe, seed: int, twin: int) -> dict[str, Any]:
    from stages.exam import exam

    candidate = steps.material.ids(0, "train")[0]
    graded = steps.material.outputs(0, "exam")["results"][candidate]
    record, verdict = steps.store.policy(candidate), steps.store.verdict(steps.material.ids(0, "gate")[0])
    still: Policy = Still()
    plain = exam(steps.policy(candidate), recipe, seed=seed, twin=twin, look=NOMINAL).success
    return {
        "policy": candidate, "bits": graded["bits"], "strata": graded["strata"],
        "plain": "".join("01"[int(s)] for s in plain),
        "still": "".join("01"[int(s)] for s in exam(still, recipe, seed=seed, twin=twin).success),
        "gate": [r.model_dump() for r in verdict.strata], "frames": steps.material.version(0).frames,
        "held_out_loss": record.held_out_loss, "train_loss": record.train_loss, "onnx_error": record.onnx_error}


def _common(arm: Mapping[str, Any], key: str = "bits") -> NDArray[np.bool_]:
    return np.array([bit == "1" for bit, kind in zip(arm[key], arm["strata"], strict=True) if kind == "common"], bool)


def _pooled(found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Success over the common starts of all seeds, and the paired comparison of the arms."""
    solved, plain = ({name: np.concatenate([_common(seed["arms"][name], key) for seed in found]) for name in ARMS}
                     for key in ("bits", "plain"))
    still = np.concatenate([_common(seed["arms"]["re-rendered"], "still") for seed in found])
    gained, lost = (int((a & ~b).sum()) for a, b in (tuple(solved.values()), tuple(solved.values())[::-1]))
    rates, unmoved = ({name: wilson(int(bits.sum()), len(bits)).model_dump() for name, bits in group.items()}
                      for group in ({**solved, "still": still}, plain))
    return {"common": rates, "nominal look": unmoved, "fixed": gained, "broken": lost,
            "p": mcnemar(gained, lost).p_two_sided}


def _table(found: Sequence[Mapping[str, Any]], pooled: Mapping[str, Any]) -> Table:
    table = Table(title=f"ACT on the twin, common starts; {pooled['fixed']} scenes only re-rendered, "
                        f"{pooled['broken']} only as it was, p {pooled['p']:.2g}")
    for column in ("twin", *ARMS, "still"):
        table.add_column(column)
    for seed in found:
        rows = [_common(seed["arms"][name]) for name in ARMS] + [_common(seed["arms"]["re-rendered"], "still")]
        table.add_row(str(seed["twin"]), *(_says(wilson(int(b.sum()), len(b)).model_dump()) for b in rows))
    table.add_row("all", *(_says(pooled["common"][name]) for name in (*ARMS, "still")))
    table.add_row("all, but that they look as training does", *(_says(pooled["nominal look"][name]) for name in ARMS))
    return table


def _says(rate: Mapping[str, Any]) -> str:
    return f"{rate['rate']:.2f} [{rate['low']:.2f} {rate['high']:.2f}] of {rate['n']}"
