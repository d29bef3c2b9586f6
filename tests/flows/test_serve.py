import json
import os
import signal
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from flows.serve import Service, serving

pytestmark = pytest.mark.xdist_group("serve")  # one server for all of them

ROOT = Path(__file__).parents[2]
INSTALLED = any(ep.name == "hardcase-deployment-names" for ep in metadata.entry_points(group="prefect.plugins"))


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    home = tmp_path_factory.mktemp("prefect")
    quick = {"PREFECT_SERVER_SERVICES_SCHEDULER_LOOP_SECONDS": "1"}
    with serving(home, port, worker=False, **quick) as running:
        yield running


def prefect(service: Service, *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "prefect", *command], env=service.environment, cwd=ROOT, capture_output=True, text=True
    )


def test_a_run_of_the_loop_is_ordered_by_its_full_name(service):
    done = prefect(service, "deployment", "run", "closed-loop/closed-loop", "--param", "recipe=smoke")
    assert done.returncode == 0, done.stderr
    assert "Created flow run" in done.stdout


@pytest.mark.skipif(not INSTALLED, reason="the plugin is known once hardcase is installed: uv sync")
@pytest.mark.parametrize("name", ["closed-loop", "nightly"])
def test_a_run_is_ordered_by_the_short_name(service, name):
    done = prefect(service, "deployment", "run", name, "--param", "recipe=smoke")
    assert done.returncode == 0, done.stderr
    assert f"Creating flow run for deployment 'closed-loop/{name}'" in done.stdout


@pytest.mark.skipif(not INSTALLED, reason="the plugin is known once hardcase is installed: uv sync")
def test_a_short_name_that_fits_nothing_gets_prefects_own_words(service):
    done = prefect(service, "deployment", "run", "nonsense")
    assert done.returncode != 0
    assert "<FLOW_NAME>/<DEPLOYMENT_NAME>" in done.stdout + done.stderr


def test_the_nightly_deployment_gets_its_scheduled_run(service, eventually):
    def scheduled() -> bool:
        script = (
            "import asyncio, json\nfrom prefect.client.orchestration import get_client\n"
            "async def main():\n"
            "    async with get_client() as c:\n"
            "        runs = await c.read_flow_runs()\n"
            "        print(json.dumps([[r.auto_scheduled, f'{r.next_scheduled_start_time:%H:%M}'] for r in runs]))\n"
            "asyncio.run(main())"
        )
        done = subprocess.run([sys.executable, "-c", script], env=service.environment, capture_output=True, text=True)
        return [True, "02:00"] in json.loads(done.stdout)

    eventually(scheduled, "a run that the scheduler made for 02:00")


def test_serving_ends_with_the_process_that_began_it(tmp_path, free_port, eventually):
    home = tmp_path / "home"
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom flows.serve import Service\n"
        f"s = Service(Path({str(home)!r}), {free_port})\n"
        f"s.spawn('server', 'start', '--host', '127.0.0.1', '--port', '{free_port}')\n"
        "s.wait_until_up()\nprint('up', flush=True)\ntime.sleep(60)"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout.readline() == "up\n"
    assert alive(home)
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    eventually(lambda: not alive(home), "the end of the orphaned server", 20)


def alive(home: Path) -> list[int]:
    found = []
    for process in Path("/proc").iterdir():
        try:
            if f"PREFECT_HOME={home}".encode() in (process / "environ").read_bytes():
                found.append(int(process.name))
        except (OSError, ValueError):
            continue
    return found
