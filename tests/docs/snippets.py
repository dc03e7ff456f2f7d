"""Files that the site puts into a page, where the page names them."""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent


def with_snippets(text):
    """The text of a page as a reader of the site sees it."""
    return re.sub(r"^--8<--\n(.+)\n--8<--\n", lambda found: (ROOT / found[1]).read_text(), text, flags=re.M)
