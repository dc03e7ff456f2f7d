"""Nothing is sent anywhere: the commands of an ordinary day open no connection but within this computer."""

import subprocess
import sys

import pytest

from trueup.stages import demo_dataset
from trueup.stages.exporting import export_dataset

# Python asks the hook before a socket does anything, whichever library has made it.
WATCHED = """
import socket, sys

def inside(address):
    return not isinstance(address, tuple) or address[0] in ("127.0.0.1", "::1", "localhost")

def refuse(event, arguments):
    address = None
    if event in ("socket.connect", "socket.sendto", "socket.sendmsg"):
        address = arguments[1]
    elif event in ("socket.getaddrinfo", "socket.gethostbyname"):
        address = (arguments[0],)
    if address is not None and not inside(address):
        asked.append((event, address))
        raise ConnectionRefusedError(f"{event} {address}")

asked = []
sys.addaudithook(refuse)
for try_it in (
    lambda: socket.create_connection(("203.0.113.1", 80), 1),
    lambda: socket.gethostbyname("example.org"),
    lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"x", ("203.0.113.1", 9)),
):
    try:
        try_it()
    except ConnectionRefusedError:
        continue
    sys.exit("what is to be refused is not")
assert len(asked) == 3, asked
asked.clear()

from trueup.cli.main import main

for line in sys.stdin.read().splitlines():
    try:
        main(line.split("\\t"))
    except SystemExit as left:
        if left.code not in (0, None, 3):  # 3: a fit of two iterations has not converged
            sys.exit(f"{line}: {left.code}")
print("asked:", asked)
"""
FIT = "fit: {kp: all}\nsolver: {max_iterations: 2}\ndata: {budget_s: 4.0}\n"


@pytest.fixture
def lines(tmp_path):
    export_dataset(demo_dataset(tmp_path / "recorded"), tmp_path / "csv")
    (tmp_path / "fit.yaml").write_text(FIT)
    return [
        ("import", "csv", "--out", "data"),
        ("replay", "data", "--robot", "demo_arm"),
        ("gap", "data", "--out", "gap"),
        ("identify", "data", "--robot", "demo_arm", "--config", "fit.yaml", "--out", "fit"),
        ("report", "gap", "--overwrite"),
        ("export", "data", "--format", "csv", "--out", "out"),
        ("doctor",),
        ("--help",),
    ]


@pytest.mark.long
def test_no_command_of_an_ordinary_day_opens_one(lines, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WATCHED], cwd=tmp_path, input="\n".join(map("\t".join, lines)),
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "asked: []" in done.stdout
    assert (tmp_path / "fit" / "fit.json").is_file()
    assert (tmp_path / "gap" / "report.html").is_file()
