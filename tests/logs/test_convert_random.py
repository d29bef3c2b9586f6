"""Whatever stamps a log has, a frame never uses a sample that is too far away, and nothing but a refusal stops it."""

import io
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from pipeline.errors import ConfigError
from pipeline.logs.convert import convert
from pipeline.logs.resample import ticks
from pipeline.logs.tables import FrameFile
from schemas.conversion import Converted
from schemas.ingest import IngestMap

NS = 10**9
NOW = 1_760_000_000 * NS
NEAR = st.integers(0, 3 * NS).map(lambda ns: NOW + ns)
ODD = st.sampled_from([0, 1, NOW - 400 * 86_400 * NS, (1 << 62) - 1, 1 << 62, (1 << 63) - 1, (1 << 64) - 1])
STAMPS = st.lists(NEAR | NEAR | NEAR | ODD, min_size=0, max_size=40)


def log_of(topics: dict[str, list[int]], values: list[float]) -> bytes:
    out = io.BytesIO()
    writer = Writer(out, chunk_size=500)
    writer.start()
    for topic, stamps in topics.items():
        channel = writer.register_channel(topic, "json", 0)
        for k, ns in enumerate(stamps):
            stamp = {"sec": min(ns // NS, (1 << 31) - 1), "nsec": ns % NS}
            message = {"header": {"stamp": stamp}, "v": values[k % len(values)], "on": k % 5 < 3}
            writer.add_message(channel, ns, json.dumps(message).encode(), ns)
    writer.finish()
    return out.getvalue()


@settings(max_examples=60, deadline=None)
@given(a=STAMPS, b=STAMPS, sort=st.booleans(), rules=st.tuples(*[st.sampled_from(["hold", "nearest", "linear"])] * 2),
       clock=st.sampled_from(["log", "publish", "header"]), fps=st.sampled_from([1, 7, 30]),
       limit=st.sampled_from([0.02, 0.3, 1e7]), missing=st.sampled_from(["cut", "refuse"]),
       values=st.lists(st.floats(width=64), min_size=1, max_size=5),
       episodes=st.sampled_from([{"by": "file"}, {"by": "gap", "longer_than_s": 0.4},
                                 {"by": "marker", "topic": "b", "field": "on", "start": [True], "stop": [False]}]))
def test_no_frame_uses_what_lies_too_far_away(a, b, sort, rules, clock, fps, limit, missing, values, episodes):
    topics = {"a": sorted(a) if sort else a, "b": sorted(b) if sort else b}
    asked = IngestMap.model_validate({
        "name": "r", "robot": "r", "task": "t", "fps": fps, "clock": clock, "missing": missing, "min_frames": 1,
        "features": {f"f.{t}": {"topic": t, "fields": ["v"], "resample": rule, "max_skew_s": limit}
                     for t, rule in zip("ab", rules, strict=True)}, "episodes": episodes})
    with TemporaryDirectory() as folder:
        log = Path(folder) / "log.mcap"
        log.write_bytes(log_of(topics, values))
        (out := Path(folder) / "out").mkdir()
        try:
            result = Converted.model_validate(convert(str(log), asked.model_dump_json(), str(out)))
        except ConfigError as error:
            assert error.mend
            return
        if not result.spans:
            assert not (out / "frames").exists()
            return
        frames = FrameFile(out / "frames", result)
        for k, span in enumerate(result.spans):
            columns = frames.table(k).columns()
            assert all(np.isfinite(c).all() for c in columns.values())
            at = ticks(span.start_ns, 0, span.frames, fps)
            for topic, rule in zip("ab", rules, strict=True):
                skew = columns[f"skew.f.{topic}"][:, 0].astype(np.float64)
                assert (np.abs(skew) <= limit * (1 + 1e-6)).all()
                if rule != "linear":  # the sample that was used is really there
                    used = at - np.round(skew * NS).astype(np.int64)
                    near = np.abs(used[:, None] - np.array([min(s, 1 << 62) for s in topics[topic]])[None]).min(axis=1)
                    assert (near <= 2 + np.abs(skew) * NS * 2**-22).all() or clock == "header"
