"""Blueprints: how an episode, several side by side, and the table of episodes look at once."""
# pyright: reportUnknownMemberType=false

from collections.abc import Mapping, Sequence

import rerun as rr
import rerun.blueprint as rrb

from pipeline.browsing.episode import TIME
from pipeline.browsing.outline import Outline

PLOT_FOLDERS = ("joints", "hand", "action", "signals")
"""Folders in which every folder below is a plot of its own; any other folder is one plot."""
CROWDED = 5
"""Attempts from which on only the first plot of a tab has a legend: it would hide the curves."""
ACROSS = 12
"""Plots in one grid; what is more goes into further tabs."""


def of_episode(outline: Outline) -> rrb.Blueprint:
    """Robot, cameras and lanes on the left, plots on the right, what was noticed below them."""
    left: list[rrb.View | rrb.Container] = []
    if outline.bodies:
        left.append(_scene("", "robot"))
    if outline.cameras:
        views = [rrb.Spatial2DView(origin=f"/cameras/{_part(c)}", name=c) for c in outline.cameras]
        left.append(rrb.Horizontal(*views))
    if outline.states:
        left.append(_lanes(("",)))
    plots = rrb.Tabs(*_plots(outline, ("",)))
    below = rrb.Tabs(*_told(outline))
    right = rrb.Vertical(plots, below, row_shares=[4, 1])
    lanes = 1.9 if outline.cameras else 1.3
    shares = [s for has, s in ((outline.bodies, 4), (outline.cameras, 2.4), (outline.states, lanes)) if has]
    body = rrb.Horizontal(rrb.Vertical(*left, row_shares=shares), right, column_shares=[1, 1.1]) if left else right
    return rrb.Blueprint(body, _time(), rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"),
                         auto_views=False)


def beside(outlines: Mapping[str, Outline]) -> rrb.Blueprint:
    """Several attempts on one time line: a 3D view each, and every plot with the curves of all of them.

    Args:
        outlines: entity prefix, as '/champion' -> what is drawn below it.
    """
    scenes = [_scene(prefix, prefix.strip("/").replace("/", " ")) for prefix, o in outlines.items() if o.bodies]
    all_of_them = Outline(
        lines=tuple(dict.fromkeys(line for o in outlines.values() for line in o.lines)), bodies=True,
        cameras=(), states=(), events=any(o.events for o in outlines.values()))
    left = rrb.Vertical(rrb.Grid(*scenes, grid_columns=2 if len(scenes) > 1 else 1), _lanes(tuple(outlines)),
                        row_shares=[4, 1.6])
    right = rrb.Tabs(*_plots(all_of_them, tuple(outlines)), *_told(all_of_them, tuple(outlines)))
    return rrb.Blueprint(rrb.Horizontal(left, right, column_shares=[1, 1]), _time(),
                         rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"),
                         auto_views=False)


def _time() -> rrb.TimePanel:
    # paused: where a browser draws in software, playing on takes all of a core
    return rrb.TimePanel(state="collapsed", timeline=TIME, play_state="paused", loop_mode="all")


def _scene(prefix: str, name: str) -> rrb.Spatial3DView:
    eye = rrb.EyeControls3D(position=(0.78, -0.62, 0.52), look_target=(0.17, 0.0, 0.16), eye_up=(0.0, 0.0, 1.0))
    return rrb.Spatial3DView(origin=f"{prefix}/world", name=name, eye_controls=eye,
                             line_grid=rrb.LineGrid3D(visible=False), background=[24, 27, 34])


def _lanes(prefixes: Sequence[str]) -> rrb.StateTimelineView:
    return rrb.StateTimelineView(origin="/", contents=[f"+ {p}/states/**" for p in prefixes], name="what happened")


def _plots(outline: Outline, prefixes: Sequence[str]) -> list[rrb.View | rrb.Container]:
    """One tab a folder of curves."""
    tabs: list[rrb.View | rrb.Container] = []
    for folder, plots in outline.plots(PLOT_FOLDERS).items():
        views = [_plot(plot, prefixes, legend=k == 0 or len(prefixes) < CROWDED) for k, plot in enumerate(plots)]
        for k in range(0, len(views), ACROSS):
            name = folder if len(views) <= ACROSS else f"{folder} {k // ACROSS + 1}"
            part = views[k:k + ACROSS]
            tabs.append(rrb.Grid(*part, grid_columns=1 if len(part) < 4 else 2, name=name) if len(part) > 1
                        else part[0])
    return tabs


def _plot(path: str, prefixes: Sequence[str], *, legend: bool) -> rrb.TimeSeriesView:
    entity = "/".join(map(_part, path.split("/")))
    contents = [f"+ {p}/{entity}/**" for p in prefixes]
    if len(prefixes) > 1:  # commands of several attempts hide what they did
        contents += [f"- {p}/{entity}/command" for p in prefixes]
    corner = rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=legend)
    return rrb.TimeSeriesView(origin="/", contents=contents,
                              name=path.rsplit("/", 1)[-1], plot_legend=corner)


def _told(outline: Outline, prefixes: Sequence[str] = ("",)) -> list[rrb.View]:
    about = [rrb.TextDocumentView(origin=f"{p}/about", name="about " + p.strip("/") if p else "about")
             for p in prefixes]
    events = rrb.TextLogView(origin="/", contents=[f"+ {p}/events/**" for p in prefixes], name="events")
    return [*about, events] if outline.events else list(about)


def _part(name: str) -> str:
    return rr.escape_entity_path_part(name)
