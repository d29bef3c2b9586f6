"""What the catalog keeps of a run and of its steps."""

from pydantic import Field, JsonValue

from schemas.base import Frozen, Name, Sha256, ShortId


class RunInfo(Frozen):
    """One invocation of a loop: what it is (the first four fields) and what ran it."""

    recipe_name: Name
    recipe: dict[str, JsonValue] = Field(description="the whole recipe, as JSON")
    seed: int = Field(ge=0)
    twin: int = Field(ge=0)
    control: str = Field("", description="name of the control arm; empty for the loop itself")
    command: str = Field(description="the command line, for people")
    commit: str = Field("", description="version control commit, with '+' when files differed from it")
    versions: dict[str, str] = Field({}, description="package -> version: mujoco, lerobot, torch, ...")

    def same_loop(self, other: "RunInfo") -> bool:
        """Whether both are invocations of one loop; command, commit and versions may differ."""
        return all(getattr(self, name) == getattr(other, name) for name in ("recipe", "seed", "twin", "control"))


class StepManifest(Frozen):
    """A finished step. It exists if, and only if, everything the step made is in the store."""

    run: ShortId
    generation: int = Field(ge=0)
    stage: Name
    inputs: dict[str, str] = Field({}, description="what was read: name -> id or hash")
    outputs: dict[str, JsonValue] = Field({}, description="what was made: name -> ids and numbers")
    code: Sha256 | None = Field(None, description="hash of the source files of the stage")
    wall_s: float = Field(ge=0, description="how long it took [s]; a label, two runs of one step differ in it")
