"""Load an MJCF or URDF into an editable MuJoCo model, also when its meshes are missing."""

from __future__ import annotations

import contextlib
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError
from trueup.robots.extent import root_tag


def load_spec(path: Path) -> mujoco.MjSpec:
    """An editable model.

    A mesh that is not there is dropped together with the geoms that show it: the dynamics come from the
    inertials. (A body without an inertial would lose its mass by that; this is refused.)

    Raises:
        ConfigError: missing file, no valid MJCF or URDF, or masses that hang on missing meshes.
    """
    with _reading(path):
        # Places of meshes stand in the compiled model and in its fingerprint, which must not depend on where we are.
        whole = path.absolute()
        if root_tag(path) == "robot":
            return mujoco.MjSpec.from_string(_urdf_without_missing_meshes(whole))
        spec = mujoco.MjSpec.from_file(str(whole))
    _drop_missing_meshes(spec, path.parent)
    return spec


def load_whole_spec(path: Path) -> mujoco.MjSpec:
    """An editable model of which nothing is left out, for whom shapes matter: a missing mesh keeps it from compiling.

    Raises:
        ConfigError: missing file, or no valid MJCF or URDF.
    """
    with _reading(path):
        root_tag(path)
        return mujoco.MjSpec.from_file(str(path))


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Every failure of the readers, as one that names the file."""
    if not path.is_file():
        raise ConfigError(f"there is no model at {path}")
    try:
        yield
    except (ValueError, RuntimeError, mujoco.FatalError, ET.ParseError, LookupError) as error:
        raise ConfigError(f"{path} is not a model that MuJoCo can read", got=error) from error


def compile_spec(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """The compiled model.

    Raises:
        ConfigError: MuJoCo refuses it.
    """
    try:
        return spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise ConfigError(f"{path} does not compile", got=error) from error


def gravity_of(model: mujoco.MjModel) -> Float64[np.ndarray, "3"]:
    """Gravity [m/s2]; zero where the model's options switch it off."""
    off = int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    return np.zeros(3) if off else np.array(model.opt.gravity)


def _urdf_without_missing_meshes(path: Path) -> str:
    tree = ET.parse(path)  # noqa: S314 - without a DOCTYPE there are no entities
    for link in tree.iter("link"):
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                mesh = shape.find("geometry/mesh")
                if kind == "visual" or (mesh is not None and not _mesh_file(path, mesh.get("filename", "")).is_file()):
                    link.remove(shape)
    root = tree.getroot()
    for block in root.findall("mujoco"):
        root.remove(block)
    # Fixed links must not be merged: their names are where payloads and tools are attached.
    extension = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
    extension.set("fusestatic", "false")
    extension.set("strippath", "false")
    extension.set("discardvisual", "true")
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(_mesh_file(path, mesh.get("filename", ""))))
    return ET.tostring(root, encoding="unicode")


def _mesh_file(urdf: Path, filename: str) -> Path:
    """`package://name/x.stl` and `file://` are looked up beside the URDF; MuJoCo knows neither."""
    name = filename.removeprefix("file://").split("package://")[-1]
    for base in (urdf.parent, *urdf.parents):
        for candidate in (
            base / name,
            base / Path(*Path(name).parts[1:]) if len(Path(name).parts) > 1 else base / name,
        ):
            if candidate.is_file():
                return candidate.resolve()
    return urdf.parent / name


def _drop_missing_meshes(spec: mujoco.MjSpec, folder: Path) -> None:
    base = folder / spec.meshdir if spec.meshdir else folder
    missing = {mesh.name for mesh in spec.meshes if mesh.file and not (base / mesh.file).is_file()}
    if not missing:
        return
    for body in spec.bodies:
        shown = [geom for geom in body.geoms if geom.meshname in missing]
        if shown and not body.explicitinertial and body.name != "world" and any(_has_mass(geom) for geom in shown):
            raise ConfigError(
                f"body {body.name!r} has no <inertial> and its mass comes from missing meshes",
                got=sorted(geom.meshname for geom in shown),
                hint="Put the mesh files where the model expects them, or give the body an <inertial>.",
            )
        for geom in shown:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        if mesh.name in missing:
            spec.delete(mesh)


def _has_mass(geom: mujoco.MjsGeom) -> bool:
    return not (geom.mass == 0 or geom.density == 0)
