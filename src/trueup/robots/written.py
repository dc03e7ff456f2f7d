"""Robot descriptions as YAML."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from trueup.robots.spec import RobotSpec


def robot_yaml(robot: RobotSpec) -> str:
    """A robot description as YAML, without what is default anyway."""
    plain = _without_defaults(robot.to_dict(), RobotSpec(robot.name, robot.joints, robot.model).to_dict())
    joints = [{key: value for key, value in joint.items() if _worth(key, value)} for joint in robot.to_dict()["joints"]]
    own = {key: value for key, value in plain.pop("controller", {}).items() if key not in ("kind", "command")}
    said = robot.controller.kind == "model" or bool(robot.controller.command)
    command = {"command": robot.controller.signal} if said else {}
    controller = {"kind": robot.controller.kind, **command, **own}
    head = {"schema": robot.schema, "name": robot.name, "model": robot.model}
    lines = [f"- {_dumped(joint, flow=True)}" for joint in joints]
    return _dumped(head, flow=False) + "joints:\n" + "".join(lines) + _dumped({"controller": controller, **plain})


def _dumped(tree: Mapping[str, Any], *, flow: bool | None = None) -> str:
    """As YAML: what holds nothing but numbers and words on one line, or all of it."""
    return yaml.safe_dump(_lists(tree), sort_keys=False, allow_unicode=True, default_flow_style=flow, width=10_000)


def _without_defaults(tree: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    kept = {}
    for key, value in tree.items():
        if key in ("joints", "schema", "name", "model") or value == defaults.get(key):
            continue
        if isinstance(value, Mapping) and isinstance(defaults.get(key), Mapping) and defaults[key]:
            value = _without_defaults(value, defaults[key])
        elif isinstance(value, Mapping):
            value = {name: _without_none(own) for name, own in value.items()}
        kept[key] = value
    return kept


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: own for key, own in value.items() if own is not None}
    return value


def _worth(key: str, value: Any) -> bool:
    plain = {"log": "", "sign": 1, "scale": 1.0, "offset": 0.0}
    return value is not None and not (key in plain and value == plain[key])


def _lists(tree: Any) -> Any:
    """Tuples as lists: YAML's safe dumper knows no tuples."""
    if isinstance(tree, Mapping):
        return {str(key): _lists(value) for key, value in tree.items()}
    return [_lists(value) for value in tree] if isinstance(tree, list | tuple) else tree
