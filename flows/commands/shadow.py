"""`hardcase judge`: parse, call, print; cli_recordings.py adds it to `hardcase`."""

from pathlib import Path
from typing import Annotated

import typer


def judge(
    candidate: Annotated[str, typer.Argument(help="Id of a policy of this store; 8 digits are enough.")],
    run: Annotated[str | None, typer.Option(help="Id of a run. [default: the newest]")] = None,
    generation: Annotated[int | None, typer.Option(min=0, help="Deployment to judge by. [default: the last]")] = None,
    threshold: Annotated[float | None, typer.Option(help="Disagreement that counts. [default: 0.04]")] = None,
    lasting: Annotated[int | None, typer.Option(help="Ticks that it has to last. [default: 3]")] = None,
    draws: Annotated[int | None, typer.Option(help="Draws of each policy. [default: 16]")] = None,
    most: Annotated[int | None, typer.Option(help="Disagreements judged, drawn at random. [default: all]")] = None,
    checked: Annotated[int | None, typer.Option(help="Attempts also played from the start. [default: 50]")] = None,
    seed: Annotated[int | None, typer.Option(help="Of the draws. [default: 0]")] = None,
    keep: Annotated[bool, typer.Option("--keep", help="Put the hard cases into the store.")] = False,
    estimated: Annotated[bool, typer.Option("--estimated", help="Restore nothing: estimate the state from what the "
                                            "robot sensed, as for a real robot.")] = False,
    json: Annotated[Path | None, typer.Option(help="Write the whole report to this file as JSON.")] = None,
) -> None:
    """Judge a candidate by what the champion met at work: who was right where they disagreed, and what if promoted.

    The candidate need not have ridden along. The recorded state is restored, and both go on from it.

    Example: hardcase judge 3f9a1c2b --generation 1 --keep
    Example: hardcase judge 3f9a1c2b --estimated
    """
    from flows.run.shadow_report import judge_candidate, show
    from pipeline.documents import from_values
    from pipeline.files import atomic
    from pipeline.store import store_root
    from schemas.counterfactual import JudgeConfig

    asked = {"threshold": threshold, "lasting": lasting, "draws": draws, "most": most, "checked": checked, "seed": seed}
    config = from_values({name: value for name, value in asked.items() if value is not None}, JudgeConfig,
                         where="hardcase judge", example="see: hardcase judge --help")
    written = judge_candidate(store_root(), candidate, run=run, generation=generation, config=config, keep=keep,
                              estimated=estimated)
    show(written, kept=keep)
    if json is not None:
        with atomic(json) as stream:
            stream.write(written.report.model_dump_json(indent=1).encode() + b"\n")
