"""Recordings for browsing out of the store: taken from the cache, or made; and several attempts on one time line."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from flows.browse.material import Showing
from pipeline.browsing.cache import Cache
from pipeline.browsing.catalog import Entry
from pipeline.browsing.episode import draw, recording
from pipeline.browsing.layers import labels, predictions, shadows
from pipeline.browsing.outline import Outline, outline
from pipeline.browsing.shown import Shown
from pipeline.errors import ConfigError
from pipeline.store import Store
from schemas.episode import VARIANTS, Episode

if TYPE_CHECKING:
    from pipeline.policies.onnx_policy import OnnxPolicy

VARIANTS_BESIDE = 5
"""Variants that are shown with their demonstration; more make the views too small."""

type Beside = Literal["variants", "policies"]


@dataclass(frozen=True, slots=True)
class Made:
    """One episode, ready to be put into a catalog."""

    entry: Entry
    robot: str
    outlines: Mapping[str, Outline]
    """Entity prefix -> what is drawn below it; '' for an episode alone."""


class Making:
    """Makes recordings for browsing, and keeps them.

    Args:
        store: where episodes are.
        policy: whose predictions are laid over every episode; None for none.
    """

    def __init__(self, store: Store, policy: tuple[str, "OnnxPolicy"] | None = None) -> None:
        self._store, self._policy = store, policy
        self._cache, self._showing = Cache(store.root), Showing(store)

    def episode(self, episode: Episode) -> Made:
        """All layers of an episode.

        Raises:
            HardcaseError: its recording is gone or cannot be read.
        """
        place, note = self._cache.place, self._note(episode)
        base, names = place(episode, "base"), place(episode, "outline", suffix=".json")
        shadow, said = place(episode, "shadow"), place(episode, "labels", note)
        files = {"base": base, "labels": said}
        shown: Shown | None = None
        if not self._cache.has(base, names):
            shown, watched = self._showing.episode(episode)
            self._write(base, episode.id, {"": shown})
            if watched:
                with self._cache.making(shadow) as part:
                    shadows(part, episode.id, shown.seconds, watched)
            with self._cache.making(names) as part:
                part.write_text(outline(shown, watched).model_dump_json())
        if not self._cache.has(said):
            with self._cache.making(said) as part:
                labels(part, episode, note)
        if self._cache.has(shadow):
            files["shadow"] = shadow
        if self._policy is not None and (path := self._predicted(episode, shown)) is not None:
            files["predictions"] = path
        held = Outline.model_validate_json(names.read_bytes())
        return Made(Entry(episode.id, files), episode.scene.robot, {"": held})

    def beside(self, episode: Episode, kind: Beside) -> Made:
        """An episode with its variants, or with champion and candidate at its scene, in one recording.

        Raises:
            ConfigError: there is nothing to show beside it.
            HardcaseError: a recording is gone, or a policy refused.
        """
        attempts = self._variants(episode) if kind == "variants" else self._policies(episode)
        shown = {prefix: make() for prefix, make in attempts.items()}
        path = self._cache.place(episode, f"beside-{kind}", *shown)
        self._write(path, f"{episode.id}-{kind}", shown)
        return Made(Entry(f"{episode.id}-{kind}", {"base": path}), f"beside {kind}",
                    {prefix: outline(s) for prefix, s in shown.items()})

    def _variants(self, episode: Episode) -> dict[str, Callable[[], Shown]]:
        original = self._store.episode(str(episode.parent)) if episode.origin in VARIANTS else episode
        children = [e for e in self._store.episodes(parent=original.id) if e.origin in VARIANTS]
        if episode.origin in VARIANTS:
            children = [episode, *(e for e in children if e.id != episode.id)]
        if not children:
            raise ConfigError(f"episode {original.id} has no variants", where="--beside variants",
                              mend="make some: hardcase augment; or look at: hardcase browse source=scripted")
        found: dict[str, Callable[[], Shown]] = {"/demonstration": lambda: self._showing.episode(original)[0]}
        for k, child in enumerate(children[:VARIANTS_BESIDE]):
            found[f"/variant/{k}"] = lambda child=child: self._showing.remade(child)
        return found

    def _policies(self, episode: Episode) -> dict[str, Callable[[], Shown]]:
        from pipeline.policies.onnx_policy import OnnxPolicy

        if episode.scene.family == "foreign":
            raise ConfigError("nobody knows the scene of an ingested episode", where="--beside policies",
                              mend="name an episode of a simulated robot")
        champion, candidate = rivals(self._store, episode)
        names = {"champion": champion, "candidate": candidate}
        policies = {name: OnnxPolicy(self._store.path(self._store.policy(id).checkpoint) / "policy.onnx")
                    for name, id in names.items() if id is not None}
        played = self._showing.played(episode, policies)
        told = {name: f"{name} {id}" for name, id in names.items() if id}
        found: dict[str, Callable[[], Shown]] = {"/demonstration": lambda: self._showing.episode(episode)[0]}
        for name, shown in played.items():
            found[f"/{name}"] = lambda shown=shown, name=name: _retitled(shown, told[name])
        return found

    def _predicted(self, episode: Episode, shown: Shown | None) -> Path | None:
        """The layer of what the policy would do; None for a robot that it does not know."""
        from pipeline.frames import ACTION, ENVIRONMENT, STATE
        from pipeline.protocols import Observation

        assert self._policy is not None
        id, policy = self._policy
        path = self._cache.place(episode, "predictions", id)
        if self._cache.has(path):
            return path
        observed = self._showing.observed(episode)
        if observed is None:
            return None
        state, environment = observed
        assert state.shape[1] == len(STATE) and environment.shape[1] == len(ENVIRONMENT) and len(ACTION) == 5
        seconds = (shown if shown is not None else self._showing.episode(episode)[0]).seconds
        with self._cache.making(path) as part:
            predictions(part, episode.id, seconds, state, policy.chunks(Observation(state, environment)))
        return path

    def _write(self, path: Path, id: str, attempts: Mapping[str, Shown]) -> None:
        with self._cache.making(path) as part, recording(part, id) as stream:
            for number, (prefix, shown) in enumerate(attempts.items()):
                draw(stream, shown, prefix, number if prefix else None)

    def _note(self, episode: Episode) -> str:
        cases = self._store.hard_cases(episode=episode.id)
        return "; ".join(f"hard case, corrected by {c.correction}" if c.correction else "hard case" for c in cases)


def rivals(store: Store, episode: Episode) -> tuple[str, str | None]:
    """The champion of the run that an episode belongs to, and the newest policy of it that is another one.

    Raises:
        ConfigError: nothing is released there.
    """
    rows = store.query("SELECT run FROM member WHERE kind = 'episode' AND id = ?", (episode.id,))
    runs = [str(run) for (run,) in rows] or list(store.runs())
    for run in reversed(runs):
        champion = store.champion(run)
        if champion is not None:
            others = [p.id for p in store.policies(run=run) if p.id != champion.policy]
            return champion.policy, others[-1] if others else None
    raise ConfigError("no policy is released yet", where="--beside policies", mend="turn the loop first: hardcase loop")


def in_turn(episodes: Iterable[Episode]) -> dict[str, list[Episode]]:
    """Robot -> its episodes: each robot has a table and views of its own."""
    found: dict[str, list[Episode]] = {}
    for episode in episodes:
        found.setdefault(episode.scene.robot, []).append(episode)
    return found


def _retitled(shown: Shown, name: str) -> Shown:
    from dataclasses import replace

    return replace(shown, title=f"{name}: {shown.title}")
