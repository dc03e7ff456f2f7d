"""docs/llms.txt: what programs that read documentation begin with, every page in a line (llmstxt.org)."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEXT = """# trueup

> Measures, explains and closes the sim-to-real gap of robots: logs of a robot and a model of it in; error with
> intervals, identified parameters, a fitted model and learned corrections out. One command, `trueup`; results are JSON
> files with a `schema` key (files.md), and `trueup info PATH --json` says what a folder holds.

{sections}
"""
# Of a first sentence that says too much for a list.
_LONGEST = 160


def pages() -> dict[str, str]:
    """The file, from the navigation and the first sentence of each page."""
    navigation = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    sections = []
    for line in navigation.splitlines():
        if found := re.fullmatch(r"  - (.+):", line):
            sections.append(f"\n## {found[1]}\n")
        elif found := re.fullmatch(r"      - (.+): (\S+\.md)", line):
            sections.append(f"- [{found[1]}]({found[2]}): {_first_sentence(ROOT / 'docs' / found[2])}")
    return {"llms.txt": TEXT.format(sections="\n".join(sections).strip())}


def _first_sentence(page: Path) -> str:
    """Of the first paragraph, without links."""
    paragraphs = page.read_text().split("\n\n")
    first = next(text for text in paragraphs if re.match(r"(?!```)[A-Za-z`*]", text))
    plain = " ".join(re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", first).split())
    sentence = re.split(r"(?<=[.:]) ", plain)[0].removesuffix(":")
    return sentence if len(sentence) <= _LONGEST else f"{sentence[:_LONGEST].rsplit(' ', 1)[0]} …"
