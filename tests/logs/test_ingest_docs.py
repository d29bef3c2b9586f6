"""docs/ingest.md says what the command does: its example is run, its table of rules is the code's."""

import re
from datetime import date
from pathlib import Path

import numpy as np
import pytest
import yaml

from flows.data.ingest_display import ingest_all
from pipeline.logs.resample import only, pick, values
from pipeline.logs.spool import Spool
from pipeline.recording.pictures import jpeg
from pipeline.store import Store
from schemas.consent import Consent
from schemas.ingest import Camera, IngestMap, Source

PAGE = (Path(__file__).parents[2] / "docs" / "ingest.md").read_text()


def walk(foreign_log):
    """The log that the page speaks of."""
    with foreign_log() as log:
        plc = log.channel("/plc", "Plc", "ladder", b"?", "opcua")
        for k in range(2000):
            t = k / 200
            header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
            if not 6 <= t < 7:
                log.ros("/joint_states", "sensor_msgs/msg/JointState", t, {
                    "header": header, "name": ["ankle", "knee", "hip"], "velocity": [], "effort": [],
                    "position": [10.0, 20.0, 30.0]})
            if k % 4 == 0:
                log.json("cmd", t, {"torque": [t, 0, 0]})
            if k % 2 == 0:
                log.json("/imu", t, {"gyro": [0.1, 0.2, 0.3]})
            if k % 50 == 0:
                log.json("/attempt", t, {"running": t < 4 or 4.5 <= t < 9.5})
                log.put(plc, t, b"x")
            if t in (4.25, 9.75):
                log.json("/result", t, {"data": "done" if t < 5 else "fell"})
            if k % 100 == 0:
                log.json("/battery", t, {"volt": 48})
        for k in range(150):
            log.ros("/camera/head", "sensor_msgs/msg/CompressedImage", k / 15, {
                "header": header, "format": "jpeg", "data": jpeg(np.full((32, 48, 3), k, np.uint8))})
    return log.path.rename(log.path.with_name("walk.mcap"))


def test_the_worked_example_does_what_the_page_shows(foreign_log, tmp_path, monkeypatch):
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    (tmp_path / "map.yaml").write_text(PAGE.split("```yaml\n")[1].split("```")[0])
    with Store.open(tmp_path / "store", create=True) as store:
        store.add_consent(Consent(id="form-12", operator="op-7", site="lab-2", purposes=("training",),
                                  given=date(2020, 1, 1), expires=date(2099, 1, 1)))
    text, code = ingest_all([walk(foreign_log)], tmp_path / "map.yaml", dataset="walks", accept_truncated=False,
                            as_json=False)
    shown = PAGE.split("--dataset walks\n")[1].split("```")[0].strip().split("\n")
    said = re.sub(r"version [0-9a-f]{16}", "version VERSION", text)
    said = re.sub(r"held out: \S+", "held out: FOLDER", said)
    said = re.sub(r"(with schema ladder), known are .*", r"\1", said)
    assert code == 0
    assert [" ".join(line.split()) for line in said.split("\n")] == [" ".join(line.split()) for line in shown]


@pytest.mark.parametrize("rule", ["hold", "nearest", "linear"])
def test_the_table_of_rules_is_what_the_rules_do(tmp_path, rule):
    rows = {cells[0]: cells[1:] for line in PAGE.split("\n") if line.startswith("| ")
            if len(cells := [c.strip() for c in line.strip("|").split("|")]) == 8}
    at = np.array([int(c) for c in rows["frame at [ms]"]], np.int64) * 1_000_000
    spool = Spool(tmp_path / "s", 1)
    stamps = np.array([100, 110, 130, 200], np.int64) * 1_000_000
    spool.append(stamps, stamps[:, None] / 1e6)
    samples = spool.finish()
    picks = pick(samples, at, rule, 10)
    told = iter(values(samples, only(picks, picks.admissible))[:, 0])
    assert [f"{next(told):g}" if ok else "-" for ok in picks.admissible] == rows[rule]


def test_the_page_names_every_field_of_a_map():
    map_yaml = yaml.safe_load(PAGE.split("```yaml\n")[1].split("```")[0])
    assert IngestMap.model_validate(map_yaml).robot == "g1"
    for model in (IngestMap, Source):
        assert [f for f in model.model_fields if f"`{f}`" not in PAGE] == []
    assert all(field in PAGE for field in Camera.model_fields)
