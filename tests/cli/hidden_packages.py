"""The command line in an installation that lacks packages."""

import subprocess
import sys

_CODE = """
import sys
from importlib.machinery import PathFinder
hidden, found = sys.argv.pop(1), PathFinder.find_spec
def find_spec(name, path=None, target=None):
    return None if name.partition(".")[0] == hidden else found(name, path, target)
PathFinder.find_spec = find_spec
from trueup.cli.main import main
main()
"""


def without(package, words, folder):
    """Exit code, and what is said on stderr, of a command in a process of its own, where a package is not found."""
    done = subprocess.run(
        [sys.executable, "-c", _CODE, package, *words], cwd=folder, capture_output=True, text=True, timeout=120
    )
    return done.returncode, done.stderr.strip()
