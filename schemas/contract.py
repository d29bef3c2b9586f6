"""Contract: what a robot's recordings and datasets must be like, in units; read from YAML."""

from typing import Literal, Self

from pydantic import Field, model_validator

from schemas.base import Frozen, Name


class TopicRule(Frozen):
    """What is expected of one topic, or of one feature of a dataset."""

    type: str | None = Field(default=None, description="message type, such as sensor_msgs/msg/JointState")
    required: bool = True
    rate_hz: float | None = Field(default=None, gt=0, description="messages a second; None: not looked at")
    rate_tolerance: float = Field(default=0.1, gt=0, lt=1, description="share that the rate may be off")
    max_gap_s: float | None = Field(default=None, gt=0, description="longest silence [s]; None: thresholds.gap_*")
    jitter_s: float | None = Field(default=None, gt=0, description="95 % of intervals lie this close to the period [s]")


class Limit(Frozen):
    """Limits of one column, in its own unit."""

    low: float | None = None
    high: float | None = None
    speed: float | None = Field(default=None, gt=0, description="largest rate of change [unit/s]")
    unit: str = Field(default="", description="rad, m, ...; turns on the check for degrees and millimetres")

    @model_validator(mode="after")
    def low_is_below_high(self) -> Self:
        """The low limit lies below the high one."""
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low {self.low} is not below high {self.high}")
        return self


class Pair(Frozen):
    """A measured signal and the command that it follows; columns are paired by name, else by place."""

    measured: str = Field(description="TOPIC.FIELD, or the name of a feature")
    commanded: str
    kind: Literal["target", "step"] = Field(default="target", description="the command is a position, or a change")
    columns: dict[str, str] = Field(default={}, description="measured column -> commanded column, where names differ")
    lag_s: tuple[float, float] | None = Field(default=None, description="lag allowed [s]; None: thresholds.lag_*")


class CameraRule(Frozen):
    """What one camera shows, so that two of them cannot be mistaken for each other."""

    required: bool = True
    width: int | None = Field(default=None, gt=0, description="[px]")
    height: int | None = Field(default=None, gt=0, description="[px]")
    fingerprint: str | None = Field(default=None, pattern=r"^[0-9a-f]{384}$",
                                    description="median picture of a good log, 16 x 12 grey values in hex")


class Evaluation(Frozen):
    """The task that a policy trained on this data will be judged by."""

    robot: str | None = None
    task: str | None = None
    control_hz: float | None = Field(default=None, gt=0, description="rate of the actions [Hz]")
    features: dict[str, tuple[str, ...]] = Field(default={}, description="feature -> names of its values, in order")
    action: str = Field(default="action", description="the feature that is sent to the robot")
    action_low: tuple[float, ...] = Field(default=(), description="smallest action the task takes, by column")
    action_high: tuple[float, ...] = ()


class Success(Frozen):
    """When an attempt has succeeded, as far as the robot can perceive it; lengths [m]."""

    within_m: float = Field(default=0.025, gt=0, description="object to target, horizontally")
    away_m: float = Field(default=0.05, ge=0, description="tool to object, once it is let go")
    open_m: float = Field(default=0.066, ge=0, description="finger opening that counts as open")
    low_m: float = Field(default=0.006, ge=0, description="object's height above where it lay")
    hold_ticks: int = Field(default=4, ge=1)


class Thresholds(Frozen):
    """Where each check begins to complain; every number says why it is what it is.

    'Clean' is what 212 of our own episodes show: scripted on the nominal robot, deployed and corrected on twins.
    """

    gap_periods: float = Field(default=5.0, gt=1, description="longest silence in periods: a hiccup of a busy "
                               "computer takes 2 or 3, a lost second many")
    gap_s: float = Field(default=0.25, gt=0, description="and never less than this [s]: what a killed recorder "
                         "may lose, and half of the gap that ruins a grasp")
    jitter_periods: float = Field(default=0.5, gt=0, description="95 % of intervals lie within this share of a "
                                  "period: beyond it two messages can swap places")
    camera_jitter_periods: float = Field(default=1.0, gt=0, description="the same for cameras: a picture that is less "
                                         "than a period late is still nearest to its own row")
    offset_s: float = Field(default=0.2, gt=0, description="clock of one topic against the others [s]: slow cameras "
                            "take 0.15 s to deliver")
    drift_s: float = Field(default=0.05, gt=0, description="how far a topic's clock may drift off within a recording "
                           "[s]: one control period at 20 Hz")
    jump_s: float = Field(default=0.5, gt=0, description="sudden change between two clocks [s]: more than the queue "
                          "of a recorder that fell behind")
    missing_share: float = Field(default=0.0, ge=0, lt=1, description="share of sequence numbers that may be missing")
    cover_share: float = Field(default=0.1, gt=0, lt=1, description="share of the recording that a required topic may "
                               "miss at its beginning or end")
    frozen_s: float = Field(default=1.0, gt=0, description="standstill to the bit [s]: a clean gripper at its stop "
                            "stands 0.4 s while its command still moves")
    frozen_rad: float = Field(default=0.05, gt=0, description="command's motion meanwhile [rad]: ten times what "
                              "friction and backlash hold back")
    frozen_m: float = Field(default=0.02, gt=0, description="command's motion meanwhile [m]")
    lag_low_s: float = Field(default=0.0, description="measured never moves before its command [s]")
    lag_high_s: float = Field(default=0.4, description="clean robots lag 0.05 to 0.3 s, 8 frames more are 0.45 s")
    lag_correlation: float = Field(default=0.5, gt=0, le=1, description="correlation below which no lag is told; clean "
                                   "episodes reach 0.71 and more")
    answer_correlation: float = Field(default=0.3, gt=0, le=1, description="correlation, at every lag that is allowed, "
                                      "below which the motion is not the one that was commanded; clean episodes reach "
                                      "0.66 and more, with actions turned around 0.09, in random order 0.35")
    spike_rad: float = Field(default=0.1, gt=0, description="out and back within one sample [rad]; clean: 0.024")
    spike_m: float = Field(default=0.02, gt=0, description="out and back within one sample [m]")
    limit_share: float = Field(default=0.02, ge=0, description="share of a limit's range that a reading may lie beyond "
                               "it: soft stops and encoder noise")
    frozen_camera_s: float = Field(default=0.5, gt=0, description="the same picture for this long [s] ...")
    camera_motion_rad: float = Field(default=0.05, gt=0, description="... while some joint moves by this much [rad]")
    black_grey: float = Field(default=10.0, gt=0, description="mean grey value, of 255, below which nothing is seen")
    flat_grey: float = Field(default=4.0, gt=0, description="standard deviation of a picture that shows nothing")
    swap_margin: float = Field(default=0.1, gt=0, description="by how much a camera must look more like the other one "
                               "than like itself, in correlation")
    video_shift_s: float = Field(default=0.2, gt=0, description="video against joints [s]; clean: 0.04 at most, "
                                 "cameras that stamp late 0.1")
    video_gain: float = Field(default=0.03, gt=0, description="how much better the shifted video must fit, in "
                              "correlation: in an attempt that mostly stands still every shift fits")
    frames_share: float = Field(default=0.02, ge=0, description="share of pictures that may be missing")
    told_share: float = Field(default=0.1, ge=0, description="the same where the recorder itself counted each of them: "
                              "a warning up to here")
    twin_rms: float = Field(default=0.0005, ge=0, description="root mean square distance of two recordings of one "
                            "motion, in ranges of the signal: a copy through another format; replays in other physics "
                            "differ by 0.0013 and more")
    twin_rows: float = Field(default=0.5, gt=0, le=1, description="share of rows that two episodes may have in common "
                             "to the bit: real sensors repeat none")
    success_slack_m: float = Field(default=0.015, ge=0, description="perception noise and bias of the task's distances "
                                   "[m]: three standard deviations")
    statistics: float = Field(default=1e-3, gt=0, description="statistics against rows, in standard deviations")


class Contract(Frozen):
    """What is expected of one robot's data. Everything may be left out: then only what speaks for itself is checked."""

    name: Name = "default"
    topics: dict[str, TopicRule] = Field(default={}, description="topic, or feature of a dataset -> rule")
    limits: dict[str, dict[str, Limit]] = Field(default={}, description="TOPIC.FIELD or feature -> column -> limits")
    motion: tuple[Pair, ...] = ()
    cameras: dict[str, CameraRule] = Field(default={}, description="camera's topic or feature -> rule")
    max_offset_s: float | None = Field(default=None, gt=0, description="log time behind header stamps [s]; None: only "
                                       "topics against each other")
    evaluation: Evaluation | None = None
    success: Success | None = Field(default=None, description="None: that of the task that the recording names")
    consent: bool = Field(default=True, description="a recording without consent fails")
    thresholds: Thresholds = Thresholds()
