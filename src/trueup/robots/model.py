"""Load an MJCF or URDF into an editable MuJoCo model, also when its meshes are missing."""

from __future__ import annotations

import contextlib
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError
from trueup.robots.extent import folders_of, root_tag

_Asset: TypeAlias = mujoco.MjsMesh | mujoco.MjsTexture | mujoco.MjsHField | mujoco.MjsSkin


def load_spec(path: Path, *, shapes: bool = False) -> mujoco.MjSpec:
    """An editable model.

    A mesh, height field, texture or skin whose file is not there is dropped together with what shows it: the dynamics
    come from the inertials. (A body without an inertial would lose its mass by that; this is refused.)

    Args:
        path: MJCF or URDF.
        shapes: whether what bodies touch each other with must be there, since contacts are simulated.

    Raises:
        ConfigError: missing file, no valid MJCF or URDF, xacro, or masses or contacts that hang on missing files.
    """
    with _reading(path):
        # Places of meshes stand in the compiled model and in its fingerprint, which must not depend on where we are.
        whole = path.absolute()
        if root_tag(path) == "robot":
            return mujoco.MjSpec.from_string(_urdf_without_missing_meshes(whole, shapes=shapes))
        spec = mujoco.MjSpec.from_file(str(whole))
        _drop_missing(spec, folders_of(whole), shapes=shapes)
    return spec


def load_whole_spec(path: Path) -> mujoco.MjSpec:
    """An editable model of which nothing is left out, for whom shapes matter: a missing mesh keeps it from compiling.

    Raises:
        ConfigError: missing file, or no valid MJCF or URDF.
    """
    with _reading(path):
        root_tag(path)
        return mujoco.MjSpec.from_file(str(path.absolute()))


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


def _urdf_without_missing_meshes(path: Path, *, shapes: bool) -> str:
    """The URDF with what its `<mujoco>` block says, as MuJoCo reads it, and with whole paths of its meshes."""
    tree = ET.parse(path)  # noqa: S314 - without a DOCTYPE there are no entities
    root = tree.getroot()
    block = root.find("mujoco")
    block = ET.SubElement(root, "mujoco") if block is None else block
    compiler = block.find("compiler")
    compiler = ET.SubElement(block, "compiler") if compiler is None else compiler
    said = dict(compiler.attrib)
    # Fixed links must not be merged unless somebody says so: their names are where payloads and tools are attached.
    compiler.attrib = {"fusestatic": "false", "discardvisual": "true", **said, "strippath": "false"}
    shown = compiler.get("discardvisual") == "false"
    for link in tree.iter("link"):
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                mesh = shape.find("geometry/mesh")
                missing = mesh is not None and not _mesh_file(path, mesh.get("filename", ""), said).is_file()
                if missing and shapes and kind == "collision":
                    _refuse_lost_shapes([mesh.get("filename", "") if mesh is not None else ""])
                if missing or (kind == "visual" and not shown):
                    link.remove(shape)
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(_mesh_file(path, mesh.get("filename", ""), said)))
    return ET.tostring(root, encoding="unicode")


def _mesh_file(urdf: Path, filename: str, compiler: Mapping[str, str]) -> Path:
    """Where MuJoCo looks for it; else `package://name/x.stl` and `file://`, which it does not know, beside the URDF."""
    name = filename.removeprefix("file://").split("package://")[-1]
    folder = urdf.parent / compiler.get("meshdir", compiler.get("assetdir", ""))
    own = folder / (name.replace("\\", "/").rpartition("/")[2] if compiler.get("strippath") == "true" else filename)
    if own.is_file():
        return own.resolve()
    for base in (folder, urdf.parent, *urdf.parents):
        for candidate in (
            base / name,
            base / Path(*Path(name).parts[1:]) if len(Path(name).parts) > 1 else base / name,
        ):
            if candidate.is_file():
                return candidate.resolve()
    return urdf.parent / name


def state_files(spec: mujoco.MjSpec, model: mujoco.MjModel, folders: Iterable[Path]) -> None:
    """Name the files of a model by their whole paths, so that it can be written anywhere.

    Args:
        spec: the model, editable; it is changed.
        model: the same, compiled, from which the places of most files are read.
        folders: where MuJoCo has looked for those of which it keeps no place; see `extent.folders_of`.
    """
    kinds: tuple[tuple[Sequence[_Asset], np.ndarray], ...] = (
        (spec.meshes, model.mesh_pathadr),
        (spec.textures, model.tex_pathadr),
        (spec.hfields, model.hfield_pathadr),
        (spec.skins, model.skin_pathadr),
    )
    roots = tuple(folders)
    for assets, places in kinds:
        for asset in assets:
            begin = int(places[asset.id]) if asset.file else -1
            if begin >= 0:
                asset.file = model.paths[begin:].split(b"\0", 1)[0].decode()
    for texture in spec.textures:
        for number, name in enumerate(texture.cubefiles):
            if name:
                found = next((path for path in _places(name, texture, spec, roots) if path.is_file()), None)
                texture.cubefiles[number] = str(found or name)
    spec.strippath = False
    spec.meshdir = spec.texturedir = ""


def _places(name: str, asset: _Asset, spec: mujoco.MjSpec, folders: Iterable[Path]) -> Iterator[Path]:
    """Where a file of a model may lie: beside it or what it includes, in a folder that one of them says for files."""
    strip = (name.replace("\\", "/").rpartition("/")[2],) if spec.strippath else ()
    said = [part for each in (asset.compiler, spec.compiler) for part in (each.texturedir, each.meshdir)]
    for folder in folders:
        for part in dict.fromkeys((*said, "")):
            for own in (*strip, name):
                yield folder / part / own


def _drop_missing(spec: mujoco.MjSpec, folders: Iterable[Path], *, shapes: bool) -> None:
    """Take out what shows files that are not there; nothing that moves the robot may depend on them."""
    roots = tuple(folders)

    def missing(assets: Sequence[_Asset]) -> set[str]:
        return {
            asset.name
            for asset in assets
            for name in (asset.file, *(asset.cubefiles if isinstance(asset, mujoco.MjsTexture) else ()))
            if name and not any(path.is_file() for path in _places(name, asset, spec, roots))
        }

    meshes, textures, heights = missing(spec.meshes), missing(spec.textures), missing(spec.hfields)
    for body in spec.bodies:
        shown = [geom for geom in body.geoms if geom.meshname in meshes or geom.hfieldname in heights]
        if shown and not body.explicitinertial and body.name != "world" and any(_has_mass(geom) for geom in shown):
            raise ConfigError(
                f"body {body.name!r} has no <inertial> and its mass comes from missing meshes",
                got=sorted(geom.meshname for geom in shown),
                hint="Put the mesh files where the model expects them, or give the body an <inertial>.",
            )
        if shapes:
            _refuse_lost_shapes(
                [geom.meshname or geom.hfieldname for geom in shown if geom.contype or geom.conaffinity]
            )
        for geom in shown:
            spec.delete(geom)
    for material in spec.materials:
        for number, name in enumerate(material.textures):
            if name in textures:
                material.textures[number] = ""
    skins = missing(spec.skins)
    for assets, lost in (
        (spec.meshes, meshes),
        (spec.textures, textures),
        (spec.hfields, heights),
        (spec.skins, skins),
    ):
        for asset in list(assets):
            if asset.name in lost:
                spec.delete(asset)


def _refuse_lost_shapes(names: Sequence[str]) -> None:
    if names:
        raise ConfigError(
            "contacts are simulated, and the files of shapes are not there",
            got=sorted(names),
            hint="Put the files where the model expects them, or leave simulation: {contacts: true} out.",
        )


def _has_mass(geom: mujoco.MjsGeom) -> bool:
    return not (geom.mass == 0 or geom.density == 0)
