"""Restore: a moment is put back, and the recorded commands prove that it is the moment which was recorded."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.counterfactual.moment import Lab, Moment
from pipeline.protocols import Array, Ids
from pipeline.simulation.world import CONTROLLER_WIDTH, World


def put_back(world: World, ids: Ids, moments: Sequence[Moment]) -> None:
    """Put the moments, one an id, into a world."""
    world.load(ids, np.stack([m.engine for m in moments]), np.stack([m.controller for m in moments]))


def faults(moments: Sequence[Moment], lab: Lab) -> list[str | None]:
    """Restore every moment, play the commands that were recorded from there to the end, and compare each tick.

    Compared bit for bit: the engine's state, the controller's, and what the robot perceived.

    Returns:
        For each moment None, or in what and at which tick the replay first differs from the recording.
    """
    if not moments:
        return []
    world = lab.world([m.episode.scene for m in moments], [m.draws for m in moments])
    width = world.save(np.arange(1))[0].shape[1]
    found = [_misfit(m, width) for m in moments]
    fits = [i for i, wrong in enumerate(found) if wrong is None]
    if fits:
        ids = np.array(fits)
        put_back(world, ids, [moments[i] for i in fits])
        for i, wrong in _replayed(world, ids, moments).items():
            found[i] = wrong
    return found


def _misfit(moment: Moment, wanted: int) -> str | None:
    """Whether a moment cannot even be put back."""
    width = moment.engine.shape[0]
    if not width or moment.controller.shape[0] != CONTROLLER_WIDTH:
        return "no state of a simulator was recorded that could be put back"
    if width != wanted:
        return f"its state has {width} values and the robot's has {wanted}: another model was recorded"
    return None


def _replayed(world: World, ids: Ids, moments: Sequence[Moment]) -> dict[int, str]:
    """Play what was recorded; attempts that differ -> in what and where they do so first."""
    differs: dict[int, str] = {}
    tick = np.array([m.tick for m in moments])
    while len(ids):
        going: list[int] = ids.tolist()
        now = [(moments[i], int(tick[i])) for i in going]
        for name, same in _compared(world, ids, now).items():
            differ: list[int] = ids[~same].tolist()
            for i in differ:
                differs.setdefault(i, f"replaying the recorded commands does not give the recording: {name} differs "
                                      f"at tick {tick[i]}")
        going = [i for i in going if i not in differs]
        if going:
            world.act(np.stack([moments[i].trace.action[tick[i]] for i in going]), np.array(going))
        tick[going] += 1
        ids = np.array([i for i in going if tick[i] < len(moments[i].trace)], np.intp)
    return differs


def _compared(world: World, ids: Ids, now: Sequence[tuple[Moment, int]]) -> dict[str, NDArray[np.bool_]]:
    """What is compared -> which attempts hold the recorded bits."""
    engine, controller = world.save(ids)
    seen = world.observe(ids)
    pairs: dict[str, tuple[Array, list[Array]]] = {
        "the engine's state": (engine, [m.trace.sim_state[k] for m, k in now]),
        "the controller's state": (controller, [m.trace.controller[k, :CONTROLLER_WIDTH] for m, k in now]),
        "observation.state": (seen.state, [m.trace.state[k] for m, k in now]),
        "observation.environment_state": (seen.environment, [m.trace.environment[k] for m, k in now]),
    }
    return {name: (here == np.stack(then)).all(axis=1) for name, (here, then) in pairs.items()}
