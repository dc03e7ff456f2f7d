"""Which groups an HDF5 file of GapONet's layout has, and what the joints in them are called."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.dataset.importers.h5file import H5File
from trueup.dataset.importers.stated import Stated
from trueup.errors import ConfigError, DataError, FormatError, NameMismatch

ANGLES = "joint_angle_list"
LAYOUT = f"command_time_list, command_val_list and robot/joint_time_list, robot/{ANGLES} (or robot1/..., robot2/...)"

_VARIANTS = (("robot",), ("robot1", "robot2"))


def find_groups(file: H5File) -> tuple[str, ...]:
    """The groups of the variant that the file is of.

    Raises:
        FormatError: it is of neither.
    """
    top = file.names()
    for groups in reversed(_VARIANTS):
        if all(group in top for group in groups):
            return groups
    raise FormatError(f"{file.source} is of neither variant", expected=LAYOUT, available=top)


def joint_names(file: H5File, groups: Sequence[str], stated: Stated) -> list[tuple[str, ...]]:
    """Names of the columns of each group, from the user or from the file.

    Raises:
        ConfigError: neither says them, or the user stated another number of them than there are columns.
        NameMismatch: user and file say different names.
    """
    widths = [_width(file, f"{group}/{ANGLES}") for group in groups]
    said = _split([file.texts(f"{group}/joint_names") for group in groups], file.texts("joint_names"), widths)
    told = _split([stated.joints.get(group, ()) for group in groups], stated.joints.get("", ()), widths)
    if any(said) and any(told) and said != told:
        raise NameMismatch(
            f"{file.source}: the file names other joints than the mapping",
            left=[name for part in told for name in part],
            right=[name for part in said for name in part],
            left_name="stated",
            right_name="the file has",
        )
    names = told if any(told) else said
    if [len(part) for part in names] != widths:
        raise ConfigError(
            f"{file.source} does not say the names of its joints"
            if not any(names)
            else f"{file.source} has another number of columns than joints are named",
            got=" and ".join(f"{width} columns in {group}" for group, width in zip(groups, widths, strict=True))
            + (f", names {names}" if any(names) else ""),
            hint=f"State them with --mapping FILE, in the file's order:\n{_example(groups, widths)}",
        )
    return names


def _split(per_group: list[tuple[str, ...]], together: tuple[str, ...], widths: Sequence[int]) -> list[tuple[str, ...]]:
    """One list of names per group, from lists of their own or from one list for all, first group first."""
    if any(per_group) or len(together) != sum(widths):
        return per_group if any(per_group) or not together else [together, *[()] * (len(widths) - 1)]
    ends = np.cumsum(widths).tolist()
    return [together[end - width : end] for end, width in zip(ends, widths, strict=True)]


def _example(groups: Sequence[str], widths: Sequence[int]) -> str:
    lists = [
        ", ".join(f"{group}_joint{number + 1}" for number in range(min(width, 100)))
        for group, width in zip(groups, widths, strict=True)
    ]
    if len(groups) == 1:
        return f"joints: [{lists[0]}]"
    return "\n".join(["joints:", *(f"  {group}: [{names}]" for group, names in zip(groups, lists, strict=True))])


def _width(file: H5File, name: str) -> int:
    shape = file.shape(name)
    if shape is None or len(shape) != 2 or 0 in shape:
        got = "nothing" if shape is None else f"shape {shape}"
        raise DataError(f"{file.source}: {name} is no table of joints", got=got, expected="samples x joints")
    return shape[1]
