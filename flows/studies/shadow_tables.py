"""The tables of the study of shadow mode."""

from collections.abc import Mapping
from typing import Any

from rich.console import RenderableType
from rich.table import Table

WHOLE = 1000
"""Windows from here on are the whole attempt."""


def tables(found: Mapping[str, Any]) -> list[RenderableType]:
    """One table of AUROC a setting, one of alarms, and the fit beside what is shipped."""
    parts: list[RenderableType] = []
    for name, setting in found["settings"].items():
        parts += [_auroc(name, setting, "all"), _auroc(name, setting, "running"), _alarms(name, setting["alarms"])]
    fit, shipped = found["fit"], found["shipped"]
    parts.append(f"warning fitted here: bias {fit['bias']}, weights {fit['weights']}; "
                 f"shipped: bias {shipped['bias']}, weights {shipped['weights']}; {found['cpu_s']} CPU s")
    return parts


def _auroc(name: str, setting: Mapping[str, Any], kind: str) -> Table:
    """Rows are signals, columns windows."""
    which = "all attempts" if kind == "all" else "attempts that go on at the end of the window"
    table = Table(title=f"AUROC for failure, champion of the {name}: {setting['failed']} of {setting['attempts']} "
                        f"attempts failed, {setting['failed_rare']} of them from rare starts; {which}")
    windows = [w for w in next(iter(setting["auroc"].values())) if kind == "all" or int(w) < WHOLE]
    table.add_column("signal")
    for window in windows:
        failed, succeeded = setting["at_risk"][window]
        going = "" if kind == "all" else f"\n{failed} / {succeeded}"
        table.add_column(("whole" if int(window) >= WHOLE else f"{window} ticks") + going, justify="right")
    for signal, found in setting["auroc"].items():
        table.add_row(signal, *(_interval(found[w][kind]) for w in windows))
    return table


def _interval(found: list[float] | None) -> str:
    return "–" if found is None else "{:.3f} [{:.2f} {:.2f}]".format(*found)


def _alarms(name: str, found: Mapping[str, Any]) -> Table:
    table = Table("rule", "failures told before their end", "false alarms", "ticks left: median [quartiles]",
                  title=f"Alarms, champion of the {name}")
    for rule, n in found.items():
        left = "{1} [{0} {2}]".format(*n["ticks_left"]) if n["ticks_left"] else "–"
        table.add_row(rule, f"{n['told']} of {n['failures']}", f"{n['false']} of {n['successes']} successes", left)
    return table
