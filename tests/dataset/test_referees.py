"""Versions before checkers that others wrote, and lerobot's own training: whatever became of them, nothing is wrong."""

import json
import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest

from flows.data.exporting import export_version
from flows.data.importing import ImportOrder, import_folder
from pipeline.recording import read_frames
from pipeline.selftest.dataset_referees import DATASET_REFEREES, ask_about, unexpected
from pipeline.store import Store
from schemas.consent import Consent
from schemas.edits import Add, Drop, Relabel, Trim
from schemas.recipe import CameraConfig, CollectConfig, DatasetConfig, Recipe
from stages.build import build
from stages.collect import collect
from stages.derive import derive

pytestmark = pytest.mark.xdist_group("lerobot")

TASK = "pick up the cube and place it on the mark"


@pytest.fixture
def store(tmp_path):
    with Store.open(tmp_path / "store", create=True, reserve_mb=1) as opened:
        yield opened


@pytest.fixture
def demonstrated(store, tmp_path):
    """Builds a version of ten demonstrations of the scripted expert, noted in the store."""
    config = Recipe(name="referees", threads=1, collect=CollectConfig(demonstrations=10))

    def made(seed, dataset, **how):
        folder = tmp_path / f"demonstrated {seed}"
        read = [read_frames(r.path) for r in collect(config, seed=seed, folder=folder,
                                                     software={"software_commit": "tests"})]
        many = [e.model_copy(update={"blob": store.put_blob(e.id.encode())}) for e, _ in read]
        frames = {e.id: f for e, f in read}
        version = build(many, frames, config.model_copy(update={"dataset": dataset}), store=store.root, task=TASK,
                        generation=0, **how)
        store.add_version(version, many)
        return version

    return made


@pytest.fixture
def folders(store, demonstrated, footage, tmp_path):
    """Every kind of folder that we hand out."""
    plain, other = (demonstrated(seed, DatasetConfig()) for seed in (1, 2))
    filmed = demonstrated(3, DatasetConfig(cameras={"front": CameraConfig()}), footage=footage)
    a, b, c = filmed.episodes[3], filmed.episodes[5], filmed.episodes[8]
    edits = {"dropped": (plain, [Drop(episodes=plain.episodes[2:4]), Relabel(episode=plain.episodes[0],
                                                                           outcome="failure")]),
             "merged": (plain, [Add(version=other.id, episodes=other.episodes, share=0.3)]),
             "dropped and trimmed, with a camera": (filmed, [Drop(episodes=(a, b)), Trim(episode=c, start=4, stop=40)])}
    derived = {name: derive(parent, list(how), store=store.root, others={other.id: other})
               for name, (parent, how) in edits.items()}
    store.add_consent(Consent(id="form-1", operator="ada", site="lab", purposes=("training",), given="2026-01-01",
                              expires="2999-12-31"))
    export_version(filmed.id, tmp_path / "exported", root=store.root)
    export_version(plain.id, tmp_path / "foreign", root=store.root)
    (tmp_path / "foreign/meta/hardcase.json").unlink()  # else it is known again
    told = import_folder(ImportOrder(tmp_path / "foreign", consent="form-1"), store.root)
    every = {"built": plain, "with a camera": filmed, **derived, "imported": store.version(told["version"])}
    return {name: store.path(v.path) for name, v in every.items()} | {"exported": tmp_path / "exported"}


def spoiled(folder, copy):
    """A copy that lacks its last row and a video."""
    shutil.copytree(folder, copy)
    file = copy / "data/chunk-000/file-000.parquet"
    rows = pq.read_table(file)
    pq.write_table(rows.slice(0, len(rows) - 1), file)
    next(copy.rglob("*.mp4")).unlink()
    return copy


@pytest.mark.timeout(1800)
def test_no_referee_finds_anything_in_our_versions_and_all_do_in_a_spoiled_copy(folders, tmp_path):
    bad = spoiled(folders["exported"], tmp_path / "spoiled")
    said = ask_about([*folders.values(), bad])
    found = {f"{name}: {referee}": wrong for name, folder in folders.items() for referee in DATASET_REFEREES
             if (wrong := unexpected(referee, said[folder][referee]))}
    assert not found, json.dumps(found, indent=1)
    assert len(folders) == 7 and {name: o.passed for name, o in said[bad].items()} == dict.fromkeys(
        DATASET_REFEREES, False)


SMALL = ("dim_model=16", "n_heads=2", "dim_feedforward=32", "n_encoder_layers=1", "use_vae=false", "chunk_size=8",
         "n_action_steps=8", "optimizer_lr=0.001", "pretrained_backbone_weights=null", "push_to_hub=false",
         "device=cpu", "type=act")


@pytest.mark.timeout(1800)
def test_lerobot_trains_on_a_version_from_its_own_command_line(store, demonstrated, tmp_path):
    folder = store.path(demonstrated(1, DatasetConfig()).path)
    command = [sys.executable, "-m", "lerobot.scripts.lerobot_train", "--dataset.repo_id=hardcase/version",
               f"--dataset.root={folder}", "--dataset.video_backend=pyav", *(f"--policy.{word}" for word in SMALL),
               "--steps=200", "--batch_size=4", "--num_workers=0", "--log_freq=20", "--save_checkpoint=false",
               "--wandb.enable=false", f"--output_dir={tmp_path / 'trained'}"]
    homes = {name: str(tmp_path / name) for name in ("HF_HOME", "HF_DATASETS_CACHE", "HF_LEROBOT_HOME")}
    done = subprocess.run(command, capture_output=True, text=True, check=False,
                          env={**os.environ, **homes, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"})
    assert done.returncode == 0, done.stderr[-2000:]
    losses = [float(loss) for loss in re.findall(r"step:\d+ .* loss:([\d.]+)", done.stderr + done.stdout)]
    assert len(losses) == 10 and np.mean(losses[-3:]) < 0.9 * np.mean(losses[:3]), losses
