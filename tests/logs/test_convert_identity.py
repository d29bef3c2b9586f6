"""The code hash of a conversion: every file that decides its bytes is in it, and what decides none is not."""

import ast
from pathlib import Path

from pipeline.logs import identity
from pipeline.logs.identity import camera_hashes, code_hash, conversion_id
from schemas.ingest import IngestMap

ROOT = Path(__file__).parents[2]
SPARED = {
    "pipeline/errors.py": "words of refusals; a refused log has no bytes",
    "pipeline/documents.py": "reads the map, which is hashed as it was understood",
    "schemas/base.py": "kinds of ids",
}
"""Files that converting reaches and that decide no byte of it, with the reason."""
MAP = IngestMap.model_validate({"name": "a", "robot": "g1", "task": "t", "fps": 10, "cameras": {"c": {"topic": "/c"}},
                                "features": {"f": {"topic": "/f", "fields": ["x"]}}})


def reached(start: str) -> set[str]:
    """Files of ours that a file imports by name, directly or through others; packages hand on nothing here."""
    found, waiting = set[str](), [start]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found.add(name)
        for node in ast.walk(ast.parse((ROOT / name).read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                for module in (node.module, *(f"{node.module}.{alias.name}" for alias in node.names)):
                    file = module.replace(".", "/") + ".py"
                    waiting += [file] if (ROOT / file).is_file() else []
    return found


def test_every_file_that_decides_a_byte_is_in_the_hash(monkeypatch):
    hashed: list[Path] = []
    monkeypatch.setattr(identity, "source_hash", lambda files: hashed.extend(files) or "0" * 64)
    code_hash()
    names = {str(file.relative_to(ROOT)) for file in hashed}
    assert all(file.is_file() for file in hashed)
    assert sorted(reached("pipeline/logs/convert.py") - names - SPARED.keys()) == []
    assert not {f"pipeline/logs/{other}.py" for other in identity.OTHERS} & reached("pipeline/logs/convert.py")


def test_labels_change_no_id_and_everything_else_does():
    sha = "ab" * 32
    same = [MAP, *(MAP.model_copy(update=u) for u in ({"name": "b"}, {"task": "u"}, {"site": "s"}, {"consent": "c"}))]
    assert len({conversion_id(sha, m) for m in same}) == 1
    changed = [MAP.model_copy(update=u) for u in ({"fps": 11}, {"clock": "header"}, {"robot": "h1"}, {"min_frames": 3})]
    assert len({conversion_id(sha, m) for m in (MAP, *changed)}) == 5
    assert conversion_id(sha, MAP) != conversion_id("cd" * 32, MAP) != conversion_id(sha, MAP, accept_truncated=True)


def test_images_depend_on_topic_field_and_clock_alone():
    camera = MAP.cameras["c"]
    before = camera_hashes(MAP)["camera.c"]
    for update, same in (({"max_skew_s": 1.0}, True), ({"resample": "hold"}, True), ({"topic": "/d"}, False),
                         ({"field": "raw"}, False), ({"clock": "header"}, False)):
        other = MAP.model_copy(update={"cameras": {"c": camera.model_copy(update=update)}})
        assert (camera_hashes(other)["camera.c"] == before) == same
