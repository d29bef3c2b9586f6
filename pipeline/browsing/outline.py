"""What an episode's recording holds, so that a blueprint can be made without opening it."""

from collections.abc import Iterable

from pipeline.browsing.shown import Shown
from schemas.base import Frozen


class Outline(Frozen):
    """Names only; kept beside the recording in the cache."""

    lines: tuple[str, ...] = ()
    bodies: bool = False
    cameras: tuple[str, ...] = ()
    states: tuple[str, ...] = ()
    events: bool = False

    def plots(self, split: Iterable[str]) -> dict[str, list[str]]:
        """Folder -> paths whose curves share a plot; the folders of `split` have a plot for each folder in them."""
        found: dict[str, dict[str, None]] = {}
        for line in self.lines:
            folder, _, rest = line.partition("/")
            plot = f"{folder}/{rest.split('/')[0]}" if folder in split and "/" in rest else folder
            found.setdefault(folder, {})[plot] = None
        return {folder: list(plots) for folder, plots in found.items()}


def outline(shown: Shown, watched: Iterable[str] = ()) -> Outline:
    """The names of everything that is drawn of an attempt, and of the shadow policies that watched it."""
    apart = tuple(f"shadow/{policy[:8]}" for policy in watched)
    return Outline(lines=(*shown.lines, *apart), bodies=bool(shown.bodies), cameras=tuple(shown.pictures),
                   states=tuple(shown.states), events=bool(shown.events))


def together(outlines: Iterable[Outline]) -> Outline:
    """What any of several episodes holds: one blueprint serves them all."""
    every = list(outlines)

    def names(of: str) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for o in every for name in getattr(o, of)))

    return Outline(lines=names("lines"), bodies=any(o.bodies for o in every), cameras=names("cameras"),
                   states=names("states"), events=any(o.events for o in every))
