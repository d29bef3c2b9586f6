"""docs/check.md names every check and every threshold as the code does."""

from pathlib import Path

import yaml

from pipeline.check.table import CHECKS
from schemas.contract import Contract, Thresholds

PAGE = Path(__file__).parents[2] / "docs" / "check.md"


def test_the_page_lists_every_check_as_the_table_does():
    expected = ["| check | what it finds |", "|---|---|", *(f"| {n} | {e.meaning} |" for n, e in CHECKS.items())]
    assert "\n".join(expected) in PAGE.read_text()


def test_the_page_lists_every_threshold_with_its_reason():
    fields = Thresholds.model_fields.items()
    expected = ["| threshold | default | why |", "|---|---|---|",
                *(f"| {name} | {field.default:g} | {field.description} |" for name, field in fields)]
    assert "\n".join(expected) in PAGE.read_text()


def test_the_contract_that_the_page_shows_can_be_loaded():
    block = PAGE.read_text().split("```yaml\n")[1].split("```")[0]
    contract = Contract.model_validate(yaml.safe_load(block))
    assert contract.topics and contract.limits and contract.motion and contract.cameras and contract.evaluation
