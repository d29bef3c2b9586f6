"""The Arrow copies that Hugging Face's loader makes of a LeRobot dataset at its first load.

`LeRobotDataset` reads its parquet files through `Dataset.from_parquet`, which writes an Arrow copy of every
distinct set of files (and of every choice of episodes) under $HF_DATASETS_CACHE/parquet/default-<hash>, and never
deletes one. A copy does not say which files it was made from, so all that have the columns of a LeRobot dataset
are listed; lerobot makes one again when it needs it. What was downloaded from the Hub is not touched.

Source: lerobot 0.6.1 datasets/io_utils.py `load_nested_dataset`; datasets config.py `HF_DATASETS_CACHE`.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path

FRAMES = frozenset({"episode_index", "frame_index", "index", "task_index", "timestamp"})
EPISODES = frozenset({"episode_index", "data/chunk_index", "dataset_from_index", "dataset_to_index"})


def cache_folder() -> Path:
    """Where Hugging Face's `datasets` keeps its copies, by the same variables and defaults as there."""
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    home = os.environ.get("HF_HOME") or f"{cache}/huggingface"
    return Path(os.environ.get("HF_DATASETS_CACHE") or f"{home}/datasets").expanduser()


def lerobot_copies(cache: Path) -> Iterator[Path]:
    """Folders of copies that were made from LeRobot datasets, and the lock files that belong to them."""
    copies = cache / "parquet"
    if copies.is_symlink() or not copies.is_dir():
        return
    for folder in sorted(copies.glob("default-*")):
        if not folder.is_symlink() and any(map(_is_lerobot, folder.glob("*/*/dataset_info.json"))):
            yield folder
            yield from sorted(p for p in cache.glob(f"*_parquet_{folder.name}_*.lock") if not p.is_symlink())


def _is_lerobot(info: Path) -> bool:
    try:
        features = set(json.loads(info.read_text())["features"])
    except (OSError, ValueError, KeyError, TypeError):
        return False  # not a copy that was finished, or not one at all: left alone
    return features >= FRAMES or features >= EPISODES
