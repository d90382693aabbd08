"""Fields and checkpoints in files that hold numbers and a description, and never code."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

from torch import Tensor

from levelflow._version import __version__
from levelflow.boxes import Box
from levelflow.equations.equation import Equation, LevelSetEquation
from levelflow.equations.family import Family
from levelflow.equations.masks import BoxMask, Mask, PaintedMask, ProductOfMasks, SphereMask
from levelflow.equations.regional import Regional
from levelflow.equations.transport import Constant, Rotation, Source, SumOfVelocities, Transport, Twist, Velocity
from levelflow.fields import Continued, Deformed, Field, Map, Placed, Slice
from levelflow.keyframed import Keyframed
from levelflow.minimising import Progress
from levelflow.networks.invertible import Inverse, InvertibleResNet
from levelflow.networks.lipschitz import LipschitzMLP
from levelflow.networks.periodic import Periodic
from levelflow.networks.siren import SIREN
from levelflow.retimed import Retimed
from levelflow.shapes.writing import replace_file
from levelflow.transported import Transported

FORMAT = 3
_KEY = "levelflow"
_VELOCITIES: dict[str, Any] = {kind.__name__: kind for kind in (Constant, Rotation, Twist, Source)}
_MASKS: dict[str, Any] = {kind.__name__: kind for kind in (BoxMask, SphereMask)}
# The names of tensors that are tables of masks start so; those of networks do not.
_PAINTED = "mask:"
_NETWORKS: dict[str, Any] = {kind.__name__: kind for kind in (SIREN, LipschitzMLP, InvertibleResNet)}


Saved = Placed | Transported | Retimed
"""What can be saved."""


def save(field: Saved, path: str | Path) -> None:
    """Writes a field to a safetensors file whose header rebuilds it: architecture, box, times and provenance.

    Networks are placed in a box, deformed by invertible networks or their inverses if they are. A `Transported` field
    is the field that is carried, and the velocities that carry it, with their masks, and a `Retimed` field one of these
    with its keys. The file appears whole or not at all. The same field gives the same bytes.

    Raises:
        TypeError: If the field is not made of networks of this library, or not placed, or is carried by something else
            than the velocity fields of this library.
        OSError: If the file cannot be written.
    """
    layers: list[Any] = [field]
    while type(layers[-1]) is Retimed:
        layers.append(layers[-1].field)
    *retimed, moving = layers
    carried = moving.shape if isinstance(moving, Transported) else moving
    if not isinstance(carried, Placed):
        kinds = [type(part).__name__ for part in (*layers, *([] if carried is moving else [carried]))]
        raise TypeError(
            f"save: cannot write a {' of a '.join(kinds)}; fields from fit and solve, their slices, fields from fit "
            "that are Transported, and any of these Retimed can be saved, and networks that are given a box, "
            "Placed(network, box)."
        )
    header: dict[str, Any] = {
        "kind": "field",
        "network": _composition(carried.field),
        "box": _described(carried.box),
        "provenance": field.provenance,
    }
    tensors = {name: value.detach().cpu().clone() for name, value in carried.field.state_dict().items()}
    if isinstance(moving, Transported):
        header["transported"] = {
            "motion": _motion(moving.motion, tensors),
            "box": _described(moving.box),
            "time": moving.time,
            "steps": moving.steps,
            "shape": carried.provenance,
        }
    if retimed:
        header["retimed"] = [
            {"keys": list(layer.keys.items()), "ease": layer.ease, "field": layer.field.provenance}
            for layer in reversed(retimed)
        ]
    _write(path, tensors, header)


def load(path: str | Path) -> Saved:
    """Reads a field written by `save`. Nothing in the file is executed.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is cut off, from another program, a checkpoint, or from a newer levelflow.
    """
    path = Path(path)
    tensors, header = _read(path, kind="field")
    try:
        network = _field(header["network"])
        painted = {name: tensors.pop(name) for name in list(tensors) if name.startswith(_PAINTED)}
        network.load_state_dict(tensors, assign=True)
        field: Saved = Placed(network, _box(header["box"]))
        if (carried := header.get("transported")) is not None:
            field.provenance = dict(carried["shape"])
            motion = _moved(carried.get("motion", carried), painted)
            with warnings.catch_warnings():
                # That the motions of a family do not commute was said when it was made.
                warnings.simplefilter("ignore")
                field = Transported(
                    motion, field, box=_box(carried["box"]), time=carried["time"], steps=carried["steps"]
                )
        for clock in header.get("retimed", ()):
            field.provenance = dict(clock["field"])
            field = Retimed(field, dict(clock["keys"]), ease=clock["ease"])
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"load: the header of {path.name!r} does not describe its content: {error}.") from None
    field.provenance = dict(header.get("provenance", {}))
    return field


def _described(box: Box) -> dict[str, Any]:
    return {"lower": box.lower, "upper": box.upper, "times": box.times}


def _box(described: Mapping[str, Any]) -> Box:
    times = tuple((first, last) for first, last in described["times"])
    return Box(tuple(described["lower"]), tuple(described["upper"]), times)


def _composition(made: Map) -> dict[str, Any]:
    """What a map is made of, as plain values: its type and the arguments that make one of the same shape."""
    kind: dict[str, Any] = {"type": type(made).__name__}
    refusal = TypeError(
        f"save: cannot write a {type(made).__name__}, since files hold no code; {', '.join(_NETWORKS)}, and what "
        "Periodic, Inverse, Deformed, Continued, Keyframed, Slice and Placed make of them, can be saved. Distil the "
        "field into a network with fit."
    )
    if not type(made).__module__.startswith("levelflow."):
        raise refusal  # a subclass from elsewhere, of whose code the file would know nothing
    match made:
        case SIREN():
            return kind | _sizes(made) | {"omega": made.omega}
        case LipschitzMLP():
            return kind | _sizes(made)
        case InvertibleResNet():
            own = {"blocks": len(made.blocks), "frequencies": made.frequencies}
            return kind | _sizes(made) | own | {"omega": made.omega, "lipschitz": made.lipschitz}
        case Periodic():
            return kind | {"network": _composition(made.network), "axes": made.periodic, "time": made.loops}
        case Inverse():
            return kind | {"network": _composition(made.network), "tolerance": made.tolerance}
        case Deformed():
            return kind | {"field": _composition(made.field), "deformation": _composition(made.deformation)}
        case Continued():
            return kind | {"field": _composition(made.field)}
        case Slice():
            return kind | {"field": _composition(made.field), "t": made.t}
        case Placed():
            return kind | {"field": _composition(made.field), "box": _described(made.box)}
        case Keyframed():
            return kind | {"fields": [_composition(cast(Map, field)) for field in made.fields], "times": made.knots}
    raise refusal


def _sizes(network: SIREN | LipschitzMLP | InvertibleResNet) -> dict[str, int]:
    return {"space": network.space, "time": network.times, "width": network.width, "depth": network.depth}


def _composed(described: Mapping[str, Any]) -> Map:
    """The described map, with weights yet to be loaded."""
    arguments = {name: value for name, value in described.items() if name != "type"}
    match described["type"]:
        case kind if kind in _NETWORKS:
            return cast(Map, _NETWORKS[kind](**arguments))
        case "Periodic":
            inner = _composed(arguments["network"])
            if not isinstance(inner, SIREN | LipschitzMLP):
                raise ValueError(f"it has a {type(inner).__name__} that is periodic")
            return Periodic(inner, axes=arguments["axes"], time=arguments["time"])
        case "Inverse":
            network = _composed(arguments["network"])
            if not isinstance(network, InvertibleResNet):
                raise ValueError(f"it has the inverse of a {type(network).__name__}")
            return Inverse(network, tolerance=arguments["tolerance"])
        case "Deformed":
            return Deformed(_field(arguments["field"]), _composed(arguments["deformation"]))
        case "Continued":
            return Continued(_field(arguments["field"]))
        case "Slice":
            return Slice(_field(arguments["field"]), arguments["t"])
        case "Keyframed":
            return Keyframed([_field(one) for one in arguments["fields"]], arguments["times"])
        case "Placed":
            return Placed(_field(arguments["field"]), _box(arguments["box"]))
        case kind:
            raise ValueError(f"its network is a {kind!r}, which this version does not know")


def _field(described: Mapping[str, Any]) -> Field:
    made = _composed(described)
    if not isinstance(made, Field):
        raise ValueError(f"where a field belongs it has a {type(made).__name__}")
    return made


def _motion(motion: Equation, tensors: dict[str, Tensor]) -> dict[str, Any]:
    """A motion by velocity fields, or a family of them, as plain values; tables of masks are added to the tensors."""
    if isinstance(motion, Family):
        return {"family": [_motion(part, tensors) for part in motion.motions]}
    described = {}
    if isinstance(motion, Regional):
        described, motion = {"mask": _mask(motion.mask, tensors)}, motion.motion
    velocity = motion.velocity if isinstance(motion, Transport) else None
    parts = velocity.velocities if isinstance(velocity, SumOfVelocities) else (velocity,)
    for part in parts:
        if not isinstance(part, tuple(_VELOCITIES.values())):
            raise TypeError(
                f"save: cannot write a field carried by {part!r}, since files hold no code; "
                f"{', '.join(_VELOCITIES)} and their sums can be saved. Distil the field into a network with solve."
            )
    return described | {"velocities": [{"type": type(part).__name__, **asdict(cast(Any, part))} for part in parts]}


def _mask(mask: Any, tensors: dict[str, Tensor]) -> dict[str, Any]:
    kind = {"type": type(mask).__name__}
    match mask:
        case ProductOfMasks():
            return kind | {"masks": [_mask(part, tensors) for part in mask.masks]}
        case PaintedMask():
            name = f"{_PAINTED}{sum(name.startswith(_PAINTED) for name in tensors)}"
            tensors[name] = mask.table.detach().cpu().clone()
            return kind | {"table": name, "box": _described(mask.box), "name": mask.name}
        case BoxMask() | SphereMask():
            return kind | asdict(mask)
    raise TypeError(
        f"save: cannot write a field whose motion has the mask {mask!r}, since files hold no code; "
        f"{', '.join(_MASKS)}, PaintedMask and ProductOfMasks can be saved."
    )


def _moved(described: Mapping[str, Any], painted: Mapping[str, Tensor]) -> Equation:
    """The described motion."""
    if "family" in described:
        return Family(*(cast(LevelSetEquation, _moved(part, painted)) for part in described["family"]))
    motion = Transport(_velocity(described["velocities"]))
    return Regional(motion, _masked(described["mask"], painted)) if "mask" in described else motion


def _masked(described: Mapping[str, Any], painted: Mapping[str, Tensor]) -> Mask:
    """The described mask."""
    match described["type"]:
        case "ProductOfMasks":
            return ProductOfMasks(tuple(_masked(part, painted) for part in described["masks"]))
        case "PaintedMask":
            return PaintedMask(painted[described["table"]], _box(described["box"]), described["name"])
        case kind if kind in _MASKS:
            return cast(Mask, _MASKS[kind](**_arguments(described)))
        case kind:
            raise ValueError(f"its motion has a mask that is a {kind!r}, which this version does not know")


def _velocity(described: Sequence[Mapping[str, Any]]) -> Velocity:
    """The sum of the described velocity fields."""
    parts = []
    for one in described:
        if one["type"] not in _VELOCITIES:
            raise ValueError(f"its velocity is a {one['type']!r}, which this version does not know")
        parts.append(_VELOCITIES[one["type"]](**_arguments(one)))
    return parts[0] if len(parts) == 1 else SumOfVelocities(tuple(parts))


def _arguments(described: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments that make what is described, with tuples where files have lists."""
    return {key: tuple(v) if isinstance(v, list) else v for key, v in described.items() if key != "type"}


class Checkpoint:
    """Keeps an interrupted run: saves its state every few seconds, and knows it the next time.

        kept = Checkpoint("run.safetensors")
        field = solve(..., on_step=kept, state=kept.state)
        kept.remove()

    Run again after an interruption, this goes on where the last save was. A save appears whole or not at all, so a run
    may be killed at any moment.

    Args:
        path: The file of the state, a safetensors file.
        settings: What a run must have in common with the one that it goes on with; plain values under string keys.
        seconds: The time between saves.
    """

    def __init__(self, path: str | Path, *, settings: Mapping[str, Any] | None = None, seconds: float = 5.0) -> None:
        self.path, self.seconds = Path(path), seconds
        self._settings = json.loads(json.dumps(dict(settings or {})))
        self._saved = time.perf_counter()

    @property
    def state(self) -> dict[str, Tensor] | None:
        """The state that was saved last, or None if there is none.

        Raises:
            ValueError: If the file is not a checkpoint, or was made with other settings; the message says which.
        """
        if not self.path.exists():
            return None
        tensors, header = _read(self.path, kind="checkpoint")
        made = header.get("settings", {})
        changed = sorted(name for name in {*self._settings, *made} if self._settings.get(name) != made.get(name))
        if changed:
            differences = "; ".join(
                f"{name} was {made.get(name)!r} and is {self._settings.get(name)!r}" for name in changed
            )
            raise ValueError(
                f"{self.path}: the interrupted run had other settings ({differences}). Repeat it with its own, "
                "or remove the file to start afresh."
            )
        return tensors

    def __call__(self, progress: Progress) -> None:
        """Saves the state if it is time; for `on_step`."""
        if time.perf_counter() - self._saved >= self.seconds:
            tensors = {name: value.detach().cpu().contiguous() for name, value in progress.state().items()}
            _write(self.path, tensors, {"kind": "checkpoint", "settings": self._settings})
            self._saved = time.perf_counter()

    def remove(self) -> None:
        """Removes the file, when the result is safe."""
        self.path.unlink(missing_ok=True)


def describe(path: str | Path) -> dict[str, Any]:
    """The header of a field or a checkpoint, as plain values.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not a file of this library.
    """
    return _read(Path(path), kind=None)[1]


def _write(path: str | Path, tensors: Mapping[str, Tensor], header: Mapping[str, Any]) -> None:
    from safetensors.torch import save as to_bytes

    text = json.dumps({"format": FORMAT, "version": __version__, **header}, sort_keys=True)
    replace_file(Path(path), to_bytes(dict(tensors), metadata={_KEY: text}))


def _read(path: Path, *, kind: str | None) -> tuple[dict[str, Tensor], dict[str, Any]]:
    from safetensors import SafetensorError, safe_open

    if not path.exists():
        raise FileNotFoundError(f"load: there is no file {str(path)!r} (looked in {Path.cwd()}).")
    if path.is_dir():
        raise ValueError(
            f"load: {str(path)!r} is a folder; give the field in it, such as {str(path / 'field.safetensors')!r}."
        )
    try:
        with safe_open(str(path), framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except PermissionError:
        raise
    except (SafetensorError, OSError) as error:
        raise ValueError(
            f"load: {path.name!r} ({path.stat().st_size} bytes) is not a field; "
            f"it is cut off or of another kind ({error})."
        ) from None
    try:
        header = json.loads(metadata[_KEY])
    except (KeyError, json.JSONDecodeError):
        raise ValueError(
            f"load: {path.name!r} is a safetensors file of another program; it has no levelflow header."
        ) from None
    if not isinstance(header, dict):
        raise ValueError(f"load: the header of {path.name!r} is not a description: {str(header)[:40]!r}.")
    if header.get("format", 0) > FORMAT:
        raise ValueError(
            f"load: {path.name!r} was written by levelflow {header.get('version')}, which is newer than {__version__}; "
            "update levelflow."
        )
    if kind is not None and header.get("kind") != kind:
        raise ValueError(f"load: {path.name!r} holds a {header.get('kind')}, not a {kind}.")
    return tensors, header
