"""Load an MJCF or URDF into an editable MuJoCo model, also when its meshes are missing."""

from __future__ import annotations

import contextlib
import xml.etree.ElementTree as ET
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, ImpossibleLinks
from trueup.robots.extent import folders_of, refuse_pipe, root_tag
from trueup.robots.repair import drop_static, faults

_Asset: TypeAlias = mujoco.MjsMesh | mujoco.MjsTexture | mujoco.MjsHField | mujoco.MjsSkin

# Meshes that MuJoCo reads, and how many faces one in STL has at most. That has a head of 84 bytes, and 50 a face.
_MESHES = (".stl", ".obj", ".msh")
_MOST_FACES, _STL_HEAD, _STL_FACE = 200_000, 84, 50
# Of all pictures of a model together; MuJoCo takes 12 bytes for a pixel while it reads it.
_MOST_PIXELS = 10**8
_PNG, _PNG_HEAD = b"\x89PNG\r\n\x1a\n", 24
# What MuJoCo takes as it stands, and computes with.
_NUMBERS = (
    *("body_mass", "body_inertia", "body_pos", "body_quat", "body_ipos", "body_iquat"),
    *("jnt_pos", "jnt_axis", "jnt_stiffness", "qpos0", "dof_armature", "dof_damping", "dof_frictionloss"),
)
# What MuJoCo says of a body that no robot has.
_MOST_NAMES = 6
_IMPOSSIBLE = ("inertia must satisfy", "positive eigenvalues", "mass and inertia of moving bodies")


def load_spec(path: Path, *, shapes: bool = False) -> mujoco.MjSpec:
    """An editable model, of which every joint that moves has a name.

    A mesh, height field, texture or skin whose file is not there, or which MuJoCo cannot use (Collada, flat meshes),
    is dropped together with what shows it: the dynamics come from the inertials. (A body without an inertial would lose
    its mass by that; this is refused.) A hinge or slide without a name gets that of its body.

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
            spec = mujoco.MjSpec.from_string(_urdf_without_missing_meshes(whole, shapes=shapes))
        else:
            spec = mujoco.MjSpec.from_file(str(whole))
            _refuse_pipes(spec, folders_of(whole))
            _drop_missing(spec, folders_of(whole), shapes=shapes)
        _refuse_large_pictures(spec, folders_of(whole))
        if root_tag(path) == "robot" and not shapes:
            _drop_useless(spec)  # compiles, so that pictures come first
    _name_joints(spec)
    return spec


def lost_meshes(path: Path) -> str:
    """A sentence about meshes that are not there or that MuJoCo cannot read, which `load_spec` leaves out; or empty.

    Raises:
        ConfigError: missing file, no valid MJCF or URDF, or xacro.
    """
    with _reading(path):
        whole = path.absolute()
        if root_tag(path) == "robot":
            root = ET.parse(whole).getroot()  # noqa: S314 - without a DOCTYPE there are no entities
            said = dict(found.attrib) if (found := root.find("mujoco/compiler")) is not None else {}
            names = [mesh.get("filename", "") for mesh in root.iter("mesh")]
            lost = [name for name in names if not _is_readable(_mesh_file(whole, name, said))]
        else:
            spec = mujoco.MjSpec.from_file(str(whole))
            gone = _missing(spec, spec.meshes, tuple(folders_of(whole)), _is_readable)
            lost = [mesh.file for mesh in spec.meshes if mesh.name in gone]
    names = list(dict.fromkeys(lost))
    if not names:
        return ""
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return (
        f"meshes that are not there, or cannot be read, are left out: {', '.join(names[:_MOST_NAMES])}{more} "
        "(masses are the model's own)"
    )


def _name_joints(spec: mujoco.MjSpec) -> None:
    """Give hinges and slides without a name that of their body, with a number where it is taken."""
    taken = {joint.name for joint in spec.joints}
    for body in spec.bodies:
        for joint in body.joints:
            if joint.name or joint.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                continue
            own = body.name or "joint"
            names = (own, *(f"{own}.{number}" for number in range(2, len(taken) + 3)))
            joint.name = next(name for name in names if name not in taken)
            taken.add(joint.name)


def load_whole_spec(path: Path) -> mujoco.MjSpec:
    """An editable model of which nothing is left out, for whom shapes matter: a missing mesh keeps it from compiling.

    Raises:
        ConfigError: missing file, or no valid MJCF or URDF.
    """
    with _reading(path):
        root_tag(path)
        spec = mujoco.MjSpec.from_file(str(path.absolute()))
        _refuse_pipes(spec, folders_of(path.absolute()))
        _refuse_large_pictures(spec, folders_of(path.absolute()))
        return spec


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
        ConfigError: MuJoCo refuses it, or takes numbers of it that are not finite.
    """
    try:
        model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        if any(word in str(error) for word in _IMPOSSIBLE) and root_tag(path) == "robot" and (found := faults(path)):
            raise ImpossibleLinks(
                f"{path}: no body has the mass or inertia of {', '.join(fault.link for fault in found[:_MOST_NAMES])}"
                + (f" and {len(found) - _MOST_NAMES} more links" if len(found) > _MOST_NAMES else ""),
                got=f"{found[0].wrong} of {found[0].link}",
                hint=f"Correct the file, or let `trueup init {path} --repair` write a copy with possible ones.",
            ) from error
        raise ConfigError(f"{path} does not compile", got=error) from error
    for name in _NUMBERS:
        if not np.isfinite(getattr(model, name)).all():
            raise ConfigError(
                f"{path} has numbers that no robot has", got=f"{name} that is not finite", expected="finite numbers"
            )
    return model


def gravity_of(model: mujoco.MjModel) -> Float64[np.ndarray, "3"]:
    """Gravity [m/s2]; zero where the model's options switch it off."""
    off = int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    return np.zeros(3) if off else np.array(model.opt.gravity)


def _urdf_without_missing_meshes(path: Path, *, shapes: bool) -> str:
    """The URDF with what its `<mujoco>` block says, as MuJoCo reads it, and with whole paths of its meshes."""
    tree = ET.parse(path)  # noqa: S314 - without a DOCTYPE there are no entities
    root = tree.getroot()
    drop_static(root)
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
                missing = mesh is not None and not _is_readable(_mesh_file(path, mesh.get("filename", ""), said))
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


def _is_readable(mesh: Path) -> bool:
    """Whether there is a mesh that MuJoCo can read."""
    if not mesh.is_file() or mesh.suffix.lower() not in _MESHES:
        return False
    if mesh.suffix.lower() != ".stl":
        return True
    with mesh.open("rb") as file:
        head = file.read(_STL_HEAD)
    faces = int.from_bytes(head[-4:], "little") if len(head) == _STL_HEAD else 0
    return 0 < faces <= _MOST_FACES and mesh.stat().st_size >= _STL_HEAD + _STL_FACE * faces


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


def _refuse_pipes(spec: mujoco.MjSpec, folders: Iterable[Path]) -> None:
    """Refuse a model of which a mesh or a picture is a pipe or a device, wherever MuJoCo may look for it.

    Raises:
        ConfigError: there is one.
    """
    roots = tuple(folders)
    for asset in (*spec.meshes, *spec.textures, *spec.hfields, *spec.skins):
        for name in (asset.file, *(asset.cubefiles if isinstance(asset, mujoco.MjsTexture) else ())):
            for path in _places(name, asset, spec, roots) if name else ():
                with contextlib.suppress(OSError):  # a name that no file can have
                    refuse_pipe(path)


def _refuse_large_pictures(spec: mujoco.MjSpec, folders: Iterable[Path]) -> None:
    """Refuse textures and height fields that unpack to more than a computer has, before MuJoCo unpacks them.

    Raises:
        ConfigError: their sizes add up to too much.
    """
    roots, pixels = tuple(folders), 0
    for asset in (*spec.textures, *spec.hfields):
        for name in (asset.file, *(asset.cubefiles if isinstance(asset, mujoco.MjsTexture) else ())):
            found = next((path for path in _places(name, asset, spec, roots) if path.is_file()), None) if name else None
            pixels += 0 if found is None else _pixels(found)
            if pixels > _MOST_PIXELS:
                raise ConfigError(
                    f"{found} is too large a picture", got=f"{pixels:.3g} pixels", expected=f"up to {_MOST_PIXELS:.0e}"
                )


def _pixels(picture: Path) -> int:
    """Of a PNG, as its header says; of other pictures no more than their bytes."""
    with picture.open("rb") as file:
        head = file.read(_PNG_HEAD)
    if head.startswith(_PNG) and len(head) == _PNG_HEAD:
        return int.from_bytes(head[-8:-4], "big") * int.from_bytes(head[-4:], "big")
    return picture.stat().st_size


def _drop_missing(spec: mujoco.MjSpec, folders: Iterable[Path], *, shapes: bool) -> None:
    """Take out what shows files that are not there; nothing that moves the robot may depend on them."""
    missing = partial(_missing, spec, roots=tuple(folders))
    meshes, textures, heights = missing(spec.meshes, fits=_is_readable), missing(spec.textures), missing(spec.hfields)
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
    _without(spec, meshes, heights)
    for material in spec.materials:
        for number, name in enumerate(material.textures):
            if name in textures:
                material.textures[number] = ""
    for assets, lost in ((spec.textures, textures), (spec.skins, missing(spec.skins))):
        for asset in list(assets):
            if asset.name in lost:
                spec.delete(asset)


def _missing(
    spec: mujoco.MjSpec, assets: Sequence[_Asset], roots: Sequence[Path], fits: Callable[[Path], bool] = Path.is_file
) -> set[str]:
    """Names of assets of which a file is not there, or does not fit."""
    return {
        asset.name
        for asset in assets
        for name in (asset.file, *(asset.cubefiles if isinstance(asset, mujoco.MjsTexture) else ()))
        if name and not any(fits(path) for path in _places(name, asset, spec, roots))
    }


def _drop_useless(spec: mujoco.MjSpec) -> None:
    """Take out meshes that MuJoCo reads and cannot use, such as flat ones.

    Tried with copies: what has failed to compile cannot be edited any more.
    """
    while spec.meshes:
        try:
            spec.copy().compile()
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            useless = {mesh.name for mesh in spec.meshes if f"Element name '{mesh.name}'" in str(error)}
            if useless:
                _without(spec, useless)
                continue
        return


def _without(spec: mujoco.MjSpec, meshes: Collection[str], heights: Collection[str] = ()) -> None:
    """Take out meshes and height fields by their names, and what shows them."""
    for body in spec.bodies:
        for geom in list(body.geoms):
            if geom.meshname in meshes or geom.hfieldname in heights:
                spec.delete(geom)
    for assets, lost in ((spec.meshes, meshes), (spec.hfields, heights)):
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
