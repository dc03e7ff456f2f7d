"""The Dockerfile: each of its steps, run in a clean folder in place of a container's root."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
KNOWN = ("FROM", "ARG", "RUN", "WORKDIR", "COPY", "ENV", "ENTRYPOINT", "CMD")


def steps():
    """Instruction and the rest of each line; comments and blank lines are none."""
    text = re.sub(r"\\\n", " ", (ROOT / "Dockerfile").read_text())
    return [line.split(None, 1) for line in text.splitlines() if line and not line.startswith("#")]


class Container:
    """A folder in place of the root of a container."""

    def __init__(self, root, context):
        self.root, self.context, self.folder = root, context, root
        bin_ = root / "usr" / "bin"
        bin_.mkdir(parents=True)
        (bin_ / "python").symlink_to(sys._base_executable)
        self.environment = {"PATH": f"{bin_}:/usr/bin:/bin:/usr/sbin:/sbin", "HOME": str(root), "LANG": "C.UTF-8"}
        for name in ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "PIP_FIND_LINKS", "PIP_CONFIG_FILE", "PIP_TRUSTED_HOST"):
            if name in os.environ:  # where packages come from is the machine's affair
                self.environment[name] = os.environ[name]
        config = Path.home() / ".config" / "pip" / "pip.conf"
        if config.is_file():
            self.environment.setdefault("PIP_CONFIG_FILE", str(config))
        self.entry = self.command = []

    def inside(self, path):
        """A path of the container on this machine."""
        return self.root / path.lstrip("/") if path.startswith("/") else self.folder / path

    def do(self, kind, rest):
        """One instruction."""
        if kind == "ARG":
            name, value = rest.split("=", 1)
            self.environment[name] = value
        elif kind == "ENV":
            name, value = rest.split("=", 1)
            value = re.sub(r"/opt\b", f"{self.root}/opt", value)
            self.environment[name] = value.replace("$PATH", self.environment["PATH"])
        elif kind == "WORKDIR":
            self.folder = self.inside(rest)
            self.folder.mkdir(parents=True, exist_ok=True)
        elif kind == "COPY":
            *sources, target = rest.split()
            for source in sources:
                self._copy(self.context / source, self.inside(target), several=len(sources) > 1)
        elif kind == "RUN":
            self.run(["bash", "-ec", self._rewritten(rest)])
        elif kind in ("ENTRYPOINT", "CMD"):
            setattr(self, "entry" if kind == "ENTRYPOINT" else "command", json.loads(rest))

    def run(self, arguments):
        """In the container's folder and environment."""
        done = subprocess.run(
            arguments, cwd=self.folder, env=self.environment, capture_output=True, text=True, timeout=900, check=False
        )
        assert done.returncode == 0, f"{arguments}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
        return done.stdout + done.stderr

    def _copy(self, source, target, *, several):
        assert source.exists(), f"{source.name} is left out by .dockerignore, or is not there"
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True)
        else:
            assert several or not str(target).endswith("/")
            shutil.copy(source, target)

    def _rewritten(self, line):
        """Packages of the system are only looked for, not installed into this machine; the container's root is ours."""
        line = line.replace("apt-get update && ", "").replace("apt-get install -y", "apt-get install -s -y")
        line = line.replace(" && rm -rf /var/lib/apt/lists/*", "")
        return re.sub(r"(?<![\w.])/opt\b", f"{self.root}/opt", line)


@pytest.fixture
def context(tmp_path):
    """What Docker would be sent: what .dockerignore lets through."""
    folder = tmp_path / "context"
    folder.mkdir()
    allowed = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    for name in allowed:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / name)
    return folder


@pytest.mark.slow
def test_every_step_runs_in_a_clean_folder(tmp_path, context):
    container = Container(tmp_path / "root", context)
    for kind, rest in steps():
        assert kind in KNOWN
        container.do(kind, rest)
    trueup = shutil.which(container.entry[0], path=container.environment["PATH"])
    assert Path(trueup).is_relative_to(tmp_path / "root")
    assert container.folder == tmp_path / "root" / "data"
    said = container.run([trueup, *container.command])
    assert re.search(r"ros2 .*cyclonedds", said)
    assert re.search(r"run .*onnxruntime", said)
    assert not re.search(r"\btorch \d", said)
    options = ("--domain", "29", "--localhost", "--seconds", "1")
    served = container.run([trueup, "deploy", "serve", "--hardware", "mujoco", "--hz", "100", *options])
    assert "100 joint states" in served


def test_the_page_says_what_the_file_is():
    page = (ROOT / "docs" / "realtime.md").read_text()
    (_, base), (_, extras) = steps()[:2]
    assert base.startswith("python:3.11")
    assert all(f"`{extra}`" in page for extra in extras.split("=")[1].split(","))
