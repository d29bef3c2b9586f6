"""`hardcase browse` as a person meets it: what it serves, to whom, and that nothing is left when it ends."""

import http.client
import json
import signal
import socket
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest


def listening(pid: int) -> set[tuple[str, int]]:
    """Addresses that a process listens on."""
    inodes = {str(f.readlink()) for f in Path(f"/proc/{pid}/fd").iterdir() if f.is_symlink()}
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == "0A" and f"socket:[{words[9]}]" in inodes:
                address, port = words[1].split(":")
                plain = socket.inet_ntoa(bytes.fromhex(address)[::-1]) if len(address) == 8 else address
                found.add((plain, int(port, 16)))
    return found


def children(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()


def get(address: str, path: str, host: str | None = None) -> tuple[int, dict[str, str], bytes]:
    place = urlsplit(address)
    connection = http.client.HTTPConnection(str(place.hostname), place.port, timeout=240)
    connection.request("GET", path, headers={"Host": host} if host else {})
    answer = connection.getresponse()
    return answer.status, dict(answer.getheaders()), answer.read()


@pytest.fixture
def running(shelf):
    process = shelf.start("--web", "--json", "outcome=failure")
    try:
        line = process.stdout.readline()
        assert line, process.stderr.read()
        yield process, json.loads(line)
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])
def test_it_serves_this_machine_only_and_leaves_nothing_behind(running, number):
    process, said = running
    address = said["address"]
    assert said["episodes"] == 1 and urlsplit(address).hostname == "127.0.0.1"
    ports = listening(process.pid)
    assert len(ports) == 2 and {host for host, _ in ports} == {"127.0.0.1"}
    assert children(process.pid) == []
    status, headers, _ = get(address, "/")
    place = urlsplit(address).netloc
    assert status == 302 and unquote(headers["Location"]).startswith(f"/?url=rerun+http://{place}/")
    status, headers, page = get(address, headers["Location"])
    assert status == 200 and b"https://fonts" not in page and "default-src 'self'" in headers["Content-Security-Policy"]
    assert get(address, "/re_viewer_bg.wasm")[2][:4] == b"\0asm"
    assert get(address, "/../../etc/passwd")[0] == 404
    assert get(address, "/", host="evil.example")[0] == 403
    process.send_signal(number)
    assert process.wait(240) == 0
    for host, port in ports:
        with pytest.raises(OSError):
            socket.create_connection((host, port), timeout=1).close()


def test_without_a_display_it_says_so_and_how_to_go_on(shelf):
    done = shelf.run("outcome=failure")
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.splitlines() == ["there is no display to open the viewer on", "  at:   this machine",
                                        "  mend: see it in a browser: hardcase browse outcome=failure --web"]


@pytest.mark.parametrize(("arguments", "mend"), [
    (("--web", "--beside", "friends"), "use one of: policies, variants"),
    (("--web", "--beside", "variants"), "mend: name it: hardcase browse"),
    (("--web", "colour=red"), "use one of: family, frames"),
    (("--web", "--policy", "champion"), "mend: "),
], ids=["beside what", "beside several", "unknown field", "no champion"])
def test_bad_words_are_refused_in_one_line_with_the_mend(shelf, arguments, mend):
    done = shelf.run(*arguments)
    assert done.returncode == 2 and mend in done.stderr and "Traceback" not in done.stderr


def test_a_port_that_is_taken_is_named(shelf):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        done = shelf.run("--web", "--port", str(port), shelf.failure.id)
    assert done.returncode == 2 and f"port {port} cannot be used" in done.stderr
    assert "mend: name another one, or leave --port away" in done.stderr
