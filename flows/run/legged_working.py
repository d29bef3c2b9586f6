"""The deployment side of a legged robot's lap: exam, deployment, harvest."""


from flows.run import facts, worked
from flows.run.arm_run import ArmRun, Made, no_rows
from flows.run.legged_learning import rl_of
from flows.run.steps_api import Progress
from pipeline.exam import ExamResult
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.tasks import load_legged_task
from pipeline.locomotion.world import width_of
from pipeline.shadow.riders import Riders
from pipeline.shadow.sizes import legged
from pipeline.store import Transaction
from schemas.verdict import Proportion
from stages.deploy_legged import deploy_legged
from stages.exam_legged import exam_legged, stands_by
from stages.harvest_legged import harvest_legged


def examined(run: ArmRun, generation: int, progress: Progress) -> Made:
    """Champion and candidate on the starts that no decision reads; a policy sits its exam once."""
    def sit(policy: str) -> tuple[ExamResult, dict[str, Proportion]]:
        done = exam_legged(run.policy(policy), run.recipe, seed=run.seed, twin=run.twin)
        return done, stands_by(done.success, done.strata, run.recipe)

    return worked.examined(run, generation, progress, sit, lambda mix: (
        f"champion falls in {1 - mix.rate:.3f} [{1 - mix.high:.3f} {1 - mix.low:.3f}] at the deployment mix"))


def deployed(run: ArmRun, generation: int) -> Made:
    """The champion at work."""
    if not run.arm.deploys:
        return Made((), "this arm does not deploy", {"robot_s": 0.0}, no_rows)
    champion, config = run.champion(generation), run.recipe.deploy
    others = run.material.riders(champion, config.riders) if config.shadow else []
    body = load_legged(run.recipe.robot)
    sizes = legged(width_of(body, load_legged_task(run.recipe.task)), len(body.joints))
    with Riders({id: run.file(id) for id in others}, patient=True, sizes=sizes) as riders:
        done = deploy_legged(run.policy(champion), champion, run.recipe, seed=run.seed, twin=run.twin,
                             generation=generation, folder=run.folder(), software=facts.software("deploy_legged"),
                             riders=riders if others else None)
    fell = sum(r.episode.outcome.label == "failure" for r in done.recorded)
    return run.recorded(done.recorded, f"{fell} of {len(done.recorded)} attempts ended in a fall", worked.worked(done))


def harvested(run: ArmRun, generation: int) -> Made:
    """Falls become hard cases, and what was sensed before each a start for the next training."""
    if run.arm.new_data != "corrections":
        return Made((), "this arm trains at drawn starts alone", {"robot_s": 0.0, "asked": 0, "cases": []}, no_rows)
    cases = harvest_legged(run.material.failed_attempts(generation), before_s=rl_of(run).before_s,
                           generation=generation, arm=run.name)
    families: dict[str, int] = {}
    for case in cases:
        families[case.family] = families.get(case.family, 0) + 1
    told = ", ".join(f"{n} {name}" for name, n in sorted(families.items(), key=lambda f: -f[1])[:3])

    def write(tx: Transaction) -> None:
        tx.add_hard_cases(cases)

    return Made(tuple(c.id for c in cases), f"{len(cases)} falls became starts" + (f": {told}" if told else ""),
                {"robot_s": 0.0, "asked": 0, "cases": [c.id for c in cases]}, write)
