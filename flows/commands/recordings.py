"""The commands for recordings of people and of other robots: parse, call, print; cli.py adds them to `hardcase`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.commands.browse import browse
from flows.commands.consent import consent
from flows.commands.ingest import ingest
from flows.commands.lineage import forget, why
from flows.commands.measure import measure
from flows.commands.mining import commands as mining
from flows.commands.nights import commands as nightly
from flows.commands.redaction import redaction
from flows.commands.rl import rl
from flows.commands.selftest import selftest
from flows.commands.shadow import judge
from flows.commands.teleop import teleop
from flows.commands.versions import datasets
from flows.commands.worth import worth

commands = typer.Typer()

commands.add_typer(consent, name="consent")
commands.add_typer(datasets)
commands.add_typer(measure, name="measure")
commands.add_typer(mining)
commands.add_typer(nightly)
commands.add_typer(redaction, name="redaction")
commands.add_typer(rl, name="rl")
commands.command()(browse)
commands.command()(teleop)
commands.command()(ingest)
commands.command()(why)
commands.command()(forget)
commands.command()(selftest)
commands.command()(judge)
commands.command()(worth)


@commands.command()
def check(
    names: Annotated[list[str], typer.Argument(metavar="LOG|DATASET|ID...", help="MCAP files, dataset folders, ids.")],
    contract: Annotated[Path | None, typer.Option(help="YAML file that says what is expected.")] = None,
    init: Annotated[bool, typer.Option("--init", help="Print a contract that these good logs keep.")] = False,
    json: Annotated[Path | None, typer.Option(help="Write verdicts and findings to this file as JSON.")] = None,
) -> None:
    """Look for what is wrong with recordings and datasets; what fails is kept out of training.

    Exit code 0: all passed, 1: something is wrong, 2: something cannot be read.

    Example: hardcase check run.mcap --contract contract.yaml --json verdict.json
    """
    from flows.data.checking import check_all, write_contract

    if init:
        typer.echo(write_contract(names), nl=False)
        return
    text, code = check_all(names, contract=contract, out=json)
    typer.echo(text)
    raise typer.Exit(code)


@commands.command()
def record(
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="The recording; OUT.mcap.part until it is whole.")],
    robot: Annotated[str, typer.Option(help="arm (simulated) or twin:SEED.")] = "arm",
    policy: Annotated[str, typer.Option(help="Who acts: expert, champion, or a policy's id.")] = "expert",
    shadow: Annotated[
        list[str] | None, typer.Option(help="Policy that watches and cannot act: its id; may be given again.")
    ] = None,
    camera: Annotated[
        list[str] | None, typer.Option(help="Camera of the scene to record: front, top; may be given again.")
    ] = None,
    size: Annotated[str, typer.Option(help="Width and height of pictures.")] = "320x240",
    seconds: Annotated[float, typer.Option(min=0.1, help="How long to record.")] = 10.0,
    until_success: Annotated[bool, typer.Option("--until-success", help="End as soon as the task is done.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Which start.")] = 0,
    stratum: Annotated[str | None, typer.Option(help="Kind of start. [default: common]")] = None,
    ring: Annotated[
        bool, typer.Option("--ring", help="Full rate 10 s before and 5 s after a trigger, one tick in 10 elsewhere.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """Record a simulated robot at work, in real time; made to be tried, killed, recovered and looked at.

    Example: hardcase record pick.mcap --camera front --camera top --seconds 10
    """
    from flows.commands.teleop import INTERRUPTED, picture_size
    from flows.teleop.record import RecordOrder, run_record
    from pipeline.store import store_root

    order = RecordOrder(path=out, robot=robot, policy=policy, shadows=tuple(shadow or ()),
                        cameras=tuple(camera or ()), size=picture_size(size), seconds=seconds,
                        until_success=until_success, seed=seed, stratum=stratum, ring=ring)
    if run_record(order, store_root(), as_json=json):
        raise typer.Exit(INTERRUPTED)


@commands.command()
def film(
    recording: Annotated[Path, typer.Argument(metavar="IN.mcap", help="A recording of a simulated robot.")],
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="The same recording with pictures.")],
    camera: Annotated[
        list[str] | None, typer.Option(help="Camera of the scene: front, top; may be given again.")
    ] = None,
    size: Annotated[str, typer.Option(help="Width and height of pictures.")] = "320x240",
) -> None:
    """Film a simulated attempt afterwards: each recorded state, through any camera of its scene.

    Example: hardcase film attempt.mcap filmed.mcap --camera front --camera top --size 640x480
    """
    from flows.commands.teleop import picture_size
    from flows.teleop.film import film

    typer.echo(film(recording, out, camera or (), picture_size(size)))
