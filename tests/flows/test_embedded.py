"""Where the embedded Prefect lives, and when there is none."""

import sqlite3
import subprocess
import sys
from pathlib import Path

from flows.serve import serving


def test_a_fresh_prefect_home_is_made_with_its_parents(counting, tmp_path):
    home = tmp_path / "not/there/yet"
    done = counting.run("loop", "--recipe", "smoke", PREFECT_HOME=str(home))
    assert done.returncode == 0, done.stderr
    assert (home / "prefect.db").exists()
    assert not (counting.store / ".prefect").exists()


def test_a_prefect_home_that_cannot_be_made_is_one_line_with_its_mend(counting, tmp_path):
    (tmp_path / "file").write_text("")
    done = counting.run("loop", "--recipe", "smoke", PREFECT_HOME=str(tmp_path / "file/home"))
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == "  mend: set PREFECT_HOME to a folder that you may write"


def test_a_server_of_the_users_is_used_and_none_started(counting, tmp_path, free_port):
    with serving(tmp_path / "own", free_port, worker=False) as service:
        process = counting.start("loop", "--recipe", "smoke", PREFECT_API_URL=service.url, COUNTING_SLEEP_S="0.2")
        counting.wait_for("begin 0 augment")
        assert counting.servers() == []
        process.communicate(timeout=240)
    assert process.returncode == 0
    runs = sqlite3.connect(tmp_path / "own/prefect.db")
    assert runs.execute("SELECT state_name FROM flow_run WHERE NOT auto_scheduled").fetchall() == [("Completed",)]


def test_the_database_of_a_fresh_store_is_what_prefects_own_migrations_make(counting, tmp_path):
    counting.run("loop", "--recipe", "smoke")
    own = tmp_path / "own"
    own.mkdir()
    environment = {**counting.environment, "PREFECT_HOME": str(own)}
    upgrade = [sys.executable, "-m", "prefect", "server", "database", "upgrade", "-y"]
    assert subprocess.run(upgrade, env=environment, capture_output=True).returncode == 0
    ours = schema(counting.store / ".prefect/prefect.db")
    assert len(ours[0]) > 100
    assert ours == schema(own / "prefect.db")


def schema(database: Path) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Every table and index with its columns, and the newest migration; their order differs from run to run."""
    columns = (
        "SELECT m.type, m.name, c.name, c.type, c.'notnull' FROM sqlite_master m, pragma_table_info(m.name) c "
        "UNION SELECT m.type, m.name, i.name, '', '' FROM sqlite_master m, pragma_index_info(m.name) i ORDER BY 1, 2, 3"
    )
    with sqlite3.connect(database) as db:
        return db.execute(columns).fetchall(), db.execute("SELECT version_num FROM alembic_version").fetchall()
