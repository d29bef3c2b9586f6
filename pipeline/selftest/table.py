"""FAULTS: every planted fault by name, what it is, what it is planted in, and which checks are meant for it."""

import json
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pipeline.lerobot_view.layout import MANIFEST, STATS
from pipeline.selftest import cameras, clocks, files, labels, measured_rows, messages, rows, values, video
from pipeline.selftest.dataset import Dataset
from pipeline.selftest.log import Log
from pipeline.selftest.material import REFUSED, Fault, Kind, Site

type Rng = np.random.Generator


def _log(change: Callable[[Log, Rng], None]) -> Callable[[Site], None]:
    """A change of messages or metadata as a planter: read, change, write anew."""
    def plant(site: Site) -> None:
        log = Log.read(site.clean)
        change(log, site.rng)
        log.write(site.out)
    return plant


def _bytes(change: Callable[[bytes, Rng], bytes]) -> Callable[[Site], None]:
    """A change of a file's bytes as a planter."""
    def plant(site: Site) -> None:
        Log.read(site.clean).write(site.out)  # several chunks, as every recording of some length has
        site.out.write_bytes(change(site.out.read_bytes(), site.rng))
    return plant


def _rows(change: Callable[[Dataset, Rng], None], what: str, *expect: str) -> Fault:
    """A fault of a dataset's rows and tables, built so from the beginning."""
    def plant(site: Site) -> None:
        data = Dataset(site.clean, site.out)
        change(data, site.rng)
        data.write()
    return Fault(what, "dataset", plant, expect)


def _video(change: Callable[[Path, Path, Rng], None], what: str, *expect: str) -> Fault:
    """A fault of a dataset's videos."""
    def plant(site: Site) -> None:
        change(site.clean, site.out, site.rng)
    return Fault(what, "film dataset", plant, expect)


def _in(kind: Kind, change: Callable[[Log, Rng], None], what: str, *expect: str, beside: bool = False) -> Fault:
    return Fault(what, kind, _log(change), expect, beside)


def _edited(site: Site) -> None:
    """Somebody edited the statistics after the version was built: the manifest promises other bytes."""
    Dataset(site.clean, site.out)
    text = (site.out / STATS).read_text()
    (site.out / STATS).write_text(text.replace("\n", "\n ", 1))


def _other_task(site: Site) -> None:
    """It was collected for another task than the policy will be judged by."""
    data = Dataset(site.clean, site.out)
    path = site.out / MANIFEST
    manifest = json.loads(path.read_text())
    manifest["recipe"]["task"] = "stack"
    path.write_text(json.dumps(manifest))
    data.write()


def _cut(site: Site) -> None:
    """The copy of a data file broke off after 60 to 90 % of its bytes."""
    Dataset(site.clean, site.out)
    file = next(site.out.rglob("data/**/*.parquet"))
    data = file.read_bytes()
    file.write_bytes(data[:int(site.rng.uniform(0.6, 0.9) * len(data))])


FAULTS: MappingProxyType[str, Fault] = MappingProxyType({
    # what was measured and commanded
    "frozen-joint": _in("demonstrated", values.frozen_joint, "an encoder repeats its last reading for 1.2 to 1.6 s",
                        "frozen"),
    "action-lag": _in("succeeded", values.late_actions, "actions are recorded 8 frames late", "lag"),
    "state-lag": _in("demonstrated", values.late_states, "measurements are 8 frames old", "lag"),
    "turned-actions": _in("demonstrated", values.turned_actions, "motions recorded the other way round", "answer"),
    "shuffled-actions": _in("succeeded", values.shuffled_actions, "actions recorded in random order", "answer"),
    "nan-state": _in("demonstrated", values.nan_at(values.MEASURED), "one reading is NaN", "finite"),
    "nan-action": _in("corrected", values.nan_at(values.ACTION), "one action is NaN", "finite"),
    "degrees-state": _in("succeeded", values.degrees_in(values.MEASURED), "joints measured in degrees", "units"),
    "degrees-command": _in("demonstrated", values.degrees_in(values.COMMANDED), "joints commanded in degrees", "units"),
    "millimetres-finger": _in("demonstrated", values.finger_in_millimetres, "finger opening in millimetres", "units"),
    "millimetres-tool": _in("succeeded", values.tool_in_millimetres, "tool position in millimetres", "units"),
    "spike": _in("succeeded", values.spike, "one reading jumps by 0.15 to 0.3 rad", "spikes"),
    "beyond-limits": _in("demonstrated", values.beyond_limits, "a slipped zero: readings beyond a limit", "limits"),
    # time
    "gap": _in("demonstrated", clocks.recorder_stalls, "nothing is recorded for 0.5 s", "gaps"),
    "topic-gap": _in("succeeded", clocks.topic_stalls, "the joints are silent for 0.5 s", "gaps"),
    "wrong-rate": _in("demonstrated", clocks.slow_topic, "joints at half their rate", "rates"),
    "jitter": _in("succeeded", clocks.bursts, "joint messages arrive in bursts of three", "jitter"),
    "clock-forward": _in("demonstrated", clocks.clock_set_forward, "the recorder's clock is set 1 to 3 s forward",
                         "clock-jump"),
    "clock-back": _in("corrected", clocks.clock_set_back, "the recorder's clock is set 0.6 to 1.2 s back",
                      "clock-jump"),
    "sensor-clock-jump": _in("demonstrated", clocks.sensor_clock_jumps, "one driver's clock jumps by 0.6 to 2 s",
                             "clock-jump"),
    "clock-offset": _in("demonstrated", clocks.clock_offset, "one driver's clock is 0.25 to 0.6 s off", "clock-offset"),
    "clock-drift": _in("succeeded", clocks.clock_drift, "one driver's clock drifts by 0.08 to 0.15 s", "clock-drift"),
    # messages
    "missing-topic": _in("demonstrated", messages.without(messages.COMMANDS), "no joint commands", "coverage"),
    "dying-topic": _in("succeeded", messages.topic_dies, "joint commands end at 60 to 80 %", "coverage"),
    "lost-messages": _in("demonstrated", messages.lost_messages, "three single messages are missing", "sequence"),
    "doubled-messages": _in("demonstrated", messages.doubled_messages, "four messages are there twice", "sequence"),
    "exchanged-messages": _in("succeeded", messages.exchanged_messages, "two messages in the wrong order", "sequence"),
    "torn-messages": _in("demonstrated", messages.torn_messages, "three messages shorter than defined", "coverage"),
    "fewer-than-ticks": _in("demonstrated", messages.fewer_than_ticks, "three ticks fewer than promised", "frames"),
    # files
    "truncated": Fault("the file ends after 60 to 90 %", "demonstrated", _bytes(files.truncated), ("truncated",)),
    "corrupt-chunk": Fault("one bit of a chunk has flipped", "succeeded", _bytes(files.corrupt_chunk), ("truncated",)),
    "lying-summary": Fault("the summary counts too few messages", "demonstrated", _bytes(files.lying_summary),
                           ("summary",)),
    # what it says of itself
    "false-success": _in("failed", labels.called_success, "a failure recorded as success", "success-flag"),
    "false-failure": _in("demonstrated", labels.called_failure, "a success recorded as failure", "success-flag"),
    "no-consent": _in("demonstrated", labels.no_consent, "a person drives and names no consent", "consent"),
    "feigned-simulation": _in("demonstrated", labels.feigned_simulation, "a person drives as 'simulated'", "consent"),
    "wrong-robot": _in("demonstrated", labels.says(robot="arm-7"), "of another robot", "evaluation"),
    "wrong-task": _in("demonstrated", labels.says(task="stack"), "of another task", "evaluation"),
    "wrong-control-rate": _in("demonstrated", labels.at_other_rate, "at 25 Hz instead of 20", "evaluation"),
    "duplicate": _in("demonstrated", labels.twice, "the same attempt under another id", "duplicates", beside=True),
    "near-duplicate": _in("succeeded", labels.nearly_twice, "the same attempt with four digits", "duplicates",
                          beside=True),
    "late-duplicate": _in("demonstrated", labels.twice_without_its_start, "the same attempt without its first 0.5 s",
                          "duplicates", beside=True),
    # cameras
    "swapped-cameras": _in("filmed", cameras.swapped, "two plugs exchanged", "swapped-cameras"),
    "swapped-on-the-way": _in("filmed", cameras.swapped_on_the_way, "two cameras change places in between",
                              "swapped-cameras"),
    "black-camera": _in("filmed", cameras.black, "10 black pictures", "black-camera"),
    "frozen-camera": _in("filmed", cameras.frozen, "the same picture for 1 s", "frozen-camera"),
    "late-video": _in("filmed", cameras.shifted(cameras.LAG), "pictures 8 frames late", "shifted-video"),
    "early-video": _in("filmed", cameras.shifted(-cameras.LAG), "pictures 8 frames early", "shifted-video"),
    "torn-pictures": _in("filmed", cameras.torn, "three pictures lack their second half", "black-camera"),
    "missing-camera": _in("filmed", cameras.camera_lost, "a camera was not recorded", "coverage"),
    "dying-camera": _in("filmed", cameras.camera_dies, "a camera ends at 60 to 80 %", "coverage"),
    "dropped-pictures": _in("filmed", cameras.pictures_dropped, "every eighth picture left out", "frames"),
    # datasets
    "dataset-nan": _rows(rows.nan, "one value of one row is NaN", "finite"),
    "dataset-action-lag": _rows(rows.late_actions, "every row holds the action of 8 rows before", "lag"),
    "dataset-turned-actions": _rows(rows.turned_actions, "motions of one episode the other way round", "answer"),
    "dataset-shuffled-actions": _rows(rows.shuffled_actions, "actions of one episode in random order", "answer"),
    "dataset-degrees": _rows(rows.degrees, "joints in degrees", "units"),
    "dataset-absolute-actions": _rows(rows.absolute_actions, "actions are positions, not steps", "evaluation"),
    "dataset-duplicate": _rows(rows.duplicate, "a training episode is there twice", "duplicates"),
    "leak-by-content": _rows(rows.leak_by_content, "a held-out episode is a training episode again", "leaks"),
    "leak-by-descent": _rows(rows.leak_by_descent, "a variant of a training episode is held out", "leaks"),
    "dataset-false-failure": _rows(rows.false_failure, "a success is called a failure", "success-flag"),
    "old-statistics": _rows(rows.old_statistics, "statistics of two thirds of the rows", "statistics"),
    "missing-row": _rows(rows.missing_row, "one row less than the tables count", "tables"),
    "wrong-times": _rows(rows.wrong_times, "times at 30 rows a second instead of 20", "tables"),
    "dataset-wrong-robot": _rows(rows.other_robot, "of another robot", "evaluation"),
    "dataset-wrong-rate": _rows(rows.other_rate, "25 rows a second instead of 20", "evaluation"),
    "other-order": _rows(rows.other_order, "the gripper comes first in the action", "evaluation"),
    "dataset-nan-action": _rows(measured_rows.nan_action, "one action is NaN", "finite"),
    "dataset-frozen-joint": _rows(measured_rows.frozen_joint, "a joint repeats its last reading for 1.4 s", "frozen"),
    "dataset-state-lag": _rows(measured_rows.late_states, "measurements are 8 rows old", "lag"),
    "dataset-degrees-command": _rows(measured_rows.degrees_commanded, "joints commanded in degrees", "units"),
    "dataset-millimetres-finger": _rows(measured_rows.finger_in_millimetres, "finger opening in millimetres", "units"),
    "dataset-millimetres-tool": _rows(measured_rows.tool_in_millimetres, "tool position in millimetres", "units"),
    "dataset-spike": _rows(measured_rows.spike, "one reading jumps by 0.15 to 0.3 rad", "spikes"),
    "dataset-beyond-limits": _rows(measured_rows.beyond_limits, "a slipped zero: readings beyond a limit", "limits"),
    "dataset-near-duplicate": _rows(rows.near_duplicate, "a training episode again, with four digits", "duplicates"),
    "dataset-late-duplicate": _rows(rows.late_duplicate, "a training episode again, without its first 0.5 s",
                                    "duplicates"),
    "dataset-gap": _rows(rows.hole, "10 rows left out, all totals agreeing", "tables"),
    "dataset-jitter": _rows(rows.uneven_times, "times off the tick by up to 20 ms", "tables"),
    "dataset-doubled-row": _rows(rows.doubled_row, "one row is there twice, all totals agreeing", "tables"),
    "dataset-exchanged-rows": _rows(rows.exchanged_rows, "two rows in the wrong order", "tables"),
    "dataset-wrong-task": Fault("of another task", "dataset", _other_task, ("evaluation",)),
    "dataset-truncated": Fault("a data file ends after 60 to 90 %", "dataset", _cut, (REFUSED,)),
    "changed-version": Fault("edited after it was built", "dataset", _edited, ("tables",)),
    "video-dropped": _video(video.spoiled(video.dropped), "an encoder dropped three pictures", "frames"),
    "video-black": _video(video.spoiled(video.black), "10 black pictures in a video", "black-camera"),
    "video-late": _video(video.spoiled(video.late), "a video 8 frames late", "shifted-video"),
    "video-early": _video(video.spoiled(video.early), "a video 8 frames early", "shifted-video"),
    "video-frozen": _video(video.spoiled(video.frozen), "the same picture for 1 s in a video", "frozen-camera"),
    "video-dying": _video(video.spoiled(video.ends_early), "a video ends at 60 to 80 %", "frames"),
    "video-gone": _video(video.gone, "a video is missing", REFUSED),
    "video-truncated": _video(video.cut, "a video file ends after 60 to 90 %", REFUSED, "frames", "black-camera"),
    "video-swapped-on-the-way": _video(video.swapped_on_the_way, "two cameras change places in between",
                                       "swapped-cameras"),
    "video-swapped": _video(video.swapped, "two cameras exchanged in one episode", "swapped-cameras"),
})
"""Fault -> how it is planted and who should notice. Add one: a function that changes a log, and an entry here."""
