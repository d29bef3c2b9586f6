"""One version has one set of features: what disagrees is named in one line."""

import json
from pathlib import Path
from typing import Any

from pipeline.errors import DatasetError
from pipeline.frames import Features
from pipeline.lerobot_view.layout import BOOKKEEPING, INFO, INTERVENTION

MEND = "build one version for each set of features, or ingest these logs again with a map that declares the same"


def refuse_others(found: Features, expected: Features, *, robot: str, where: object) -> None:
    """Return when both name the same features with the same values in the same order.

    Raises:
        DatasetError: they do not; names the first feature that differs.
    """
    if found is expected or (list(found) == list(expected) and all(found[n] == expected[n] for n in expected)):
        return
    for name, values in expected.items():
        if name not in found:
            raise DatasetError(f"{name}, which robot {robot!r} has, is missing", where=where, mend=MEND)
        if len(found[name]) != len(values):
            raise DatasetError(f"{name} has {len(found[name])} values, robot {robot!r} expects {len(values)}",
                               where=where, mend=MEND)
        for k, (is_, should) in enumerate(zip(found[name], values, strict=True)):
            if is_ != should:
                raise DatasetError(f"{name}[{k}] is {is_!r}, robot {robot!r} expects {should!r}", where=where,
                                   mend=MEND)
    if extra := [name for name in found if name not in expected]:
        raise DatasetError(f"{extra[0]} is a feature that robot {robot!r} does not have", where=where, mend=MEND)
    raise DatasetError(f"the features stand in the order {', '.join(found)}, robot {robot!r} has {', '.join(expected)}",
                       where=where, mend=MEND)


def features_in(folder: Path) -> Features:
    """The robot's features of a version that lies in a folder, in column order.

    Raises:
        DatasetError: there is no readable meta/info.json.
    """
    try:
        declared: dict[str, Any] = json.loads((folder / INFO).read_text(encoding="utf-8"))["features"]
        return {name: tuple(map(str, what["names"] or (name,))) for name, what in declared.items()
                if name != INTERVENTION and name not in BOOKKEEPING and what["dtype"] == "float32"}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError("not a dataset version (no readable meta/info.json)", where=folder,
                           mend="give the folder of a dataset version, or build it again: hardcase build") from error
