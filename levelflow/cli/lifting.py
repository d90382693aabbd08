"""The commands that change the network of a saved field: to a larger one, and to one of fewer times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from levelflow.fields import Placed
    from levelflow.networks.siren import SIREN

FieldArgument = Annotated[Path, typer.Argument(metavar="FIELD", help="A field (.safetensors).")]
Output = Annotated[Path, typer.Option("--output", "-o", help="The field to write (.safetensors).")]


def lift(
    field: FieldArgument,
    output: Output,
    width: Annotated[int | None, typer.Option(help="Neurons of a layer; as many as there are by default.")] = None,
    depth: Annotated[int | None, typer.Option(help="Hidden layers; as many as there are by default.")] = None,
    times: Annotated[
        str | None, typer.Option(help="first:last, the times in which a field of space is to stand still.")
    ] = None,
    slope: Annotated[
        float, typer.Option(help="Of added layers, sin(slope h); 0.1 to train on, 0.001 to keep every digit.")
    ] = 0.1,
) -> None:
    """Put a field into a larger network: wider, deeper, or one of space and time."""
    from levelflow.fields import Placed
    from levelflow.networks.lifting import lift as lift_network
    from levelflow.networks.lifting import lifting_error
    from levelflow.saving import save

    loaded, network = _loaded("lift", field, output)
    if width is None and depth is None and times is None:
        raise ValueError(f"lift {field}: say to what: --width, --depth, or --times first:last for space and time.")
    if times is not None and network.times:
        first, last = loaded.box.times[0]
        raise ValueError(
            f"lift {field} --times {times}: the field moves already, from t = {first:g} to {last:g}; leave --times out."
        )
    box = loaded.box if times is None else loaded.box.during(_interval_in(times))
    lifted = lift_network(network, time=0 if times is None else 1, width=width, depth=depth, slope=slope)
    deeper = lifted.depth > network.depth
    done = {"verb": "lift", "input": str(field), "width": lifted.width, "depth": lifted.depth, "times": box.times}
    holds = loaded.provenance.get("equation") if times is None else "Stationary()"
    found = _changed(Placed(lifted, box), loaded, done | ({"slope": slope} if deeper else {}), holds)
    output.parent.mkdir(parents=True, exist_ok=True)
    save(found, output)
    typer.echo(f"{output}: {_size(network)} -> {_size(lifted)}{_moving(found)}")
    if deeper:
        error = lifting_error(network, depth=lifted.depth, slope=slope) * box.frame.scale
        typer.echo(f"added layers change values by at most {error:.2g}, {error / max(box.size):.2g} of the box")


def slice_field(
    field: FieldArgument,
    output: Output,
    time: Annotated[
        str, typer.Option("--time", help="When; for several parameters 0.5,: with a colon for each that stays.")
    ],
) -> None:
    """Write a field at one time as a field of space alone, with a network of its own."""
    from levelflow.saving import save

    loaded, network = _loaded("slice", field, output)
    if not network.times:
        raise ValueError(f"slice {field} --time {time}: the field does not depend on time; it is a slice already.")
    values = _values_in(time)
    if len(values) != network.times:
        example = ",".join(["0.5"] + [":"] * (network.times - 1))
        raise ValueError(
            f"slice {field} --time {time}: the field has {network.times} time(s) or parameter(s); give a number for "
            f"each, or a colon for one that stays: --time {example}."
        )
    done = {"verb": "slice", "input": str(field), "time": values}
    found = _changed(loaded.at(*values), loaded, done, _holding(loaded, values))
    output.parent.mkdir(parents=True, exist_ok=True)
    save(found, output)
    typer.echo(f"{output}: {field.name} at {time}{_moving(found)}")


def _loaded(call: str, path: Path, output: Path) -> tuple[Placed, SIREN]:
    """A field in a file and its network, where the result has a name that a field can have."""
    from levelflow.fields import Placed
    from levelflow.networks.siren import SIREN
    from levelflow.retimed import Retimed
    from levelflow.saving import load

    if output.suffix != ".safetensors":
        raise ValueError(
            f"{call} -o {output}: a field is a .safetensors file; name it {output.with_suffix('.safetensors')}."
        )
    field = load(path)
    if isinstance(field, Retimed):
        raise ValueError(f"{call} {path}: this field is retimed; give the one that it was made from, and retime that.")
    if not isinstance(field, Placed):
        raise ValueError(
            f"{call} {path}: this field is carried along by a velocity, without a network of space and time; "
            "give one from fit, smooth or morph, or from advect --distil."
        )
    if not isinstance(field.field, SIREN):
        raise ValueError(f"{call} {path}: its network is a {type(field.field).__name__}; only a SIREN can be changed.")
    return field, field.field


def _changed(field: Placed, source: Placed, done: dict[str, Any], holds: str | None) -> Placed:
    """A field with the provenance of its source, what was done since, and the equation that it satisfies, if any.

    An equation that held for the source only is kept with what was done.
    """
    before = source.provenance.get("equation")
    if before is not None and before != holds:
        done = {**done, "equation": before}
    field.provenance = {**source.provenance, "changes": [*source.provenance.get("changes", ()), done]}
    field.provenance.pop("equation", None)
    if holds is not None:
        field.provenance["equation"] = holds
    return field


def _holding(field: Placed, values: Sequence[float | None]) -> str | None:
    """The equation that a field satisfies in the parameters that stay: of a family the motions of these."""
    from levelflow.equations import Family
    from levelflow.equations.described import equation_of

    known = equation_of(field.provenance)
    if isinstance(known, Family):
        motions = [motion for motion, value in zip(known.motions, values, strict=True) if value is None]
        return repr(motions[0] if len(motions) == 1 else Family(*motions)) if motions else None
    # What moves with one parameter moves with the first.
    alone = len(values) == 1 or (known is not None and known.drives(len(values)) == {0})
    holds = alone and values[0] is None
    return field.provenance.get("equation") if holds else None


def _interval_in(text: str) -> tuple[float, float]:
    """`0:1`."""
    try:
        first, last = (float(part) for part in text.split(":"))
    except ValueError:
        first = last = math.nan
    if not (math.isfinite(first) and math.isfinite(last) and first < last):
        raise ValueError(f"--times {text}: give the first and the last time, in order: 0:1.")
    return first, last


def _values_in(text: str) -> list[float | None]:
    """`0.5`, or `0.5,:`; not all of them colons."""
    try:
        values = [None if part.strip() == ":" else float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if all(value is None for value in values):
        raise ValueError(f"--time {text}: give a number, 0.5, or for several parameters numbers and colons, 0.5,:.")
    return values


def _size(network: SIREN) -> str:
    return f"{network.depth} layers of {network.width}"


def _moving(field: Placed) -> str:
    return "".join(f", t from {first:g} to {last:g}" for first, last in field.box.times)
