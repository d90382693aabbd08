"""The command that plays a field to another clock."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer


def retime(
    field: Annotated[Path, typer.Argument(metavar="FIELD", help="A field that moves (.safetensors).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The field to write (.safetensors).")],
    keys: Annotated[
        str,
        typer.Option(help="new:old,new:old,...: when to show which of its times. 0:0,1:0.5,2:0.5,3:1 stops halfway."),
    ],
    ease: Annotated[
        float, typer.Option(help="1 to come to rest at every key, 0 for an even speed from key to key.")
    ] = 1.0,
) -> None:
    """Play a field to another clock: with holds, eased, back and forth. It films and exports like any other."""
    from levelflow.retimed import Retimed
    from levelflow.saving import load, save

    if output.suffix != ".safetensors":
        raise ValueError(
            f"retime -o {output}: a field is a .safetensors file; name it {output.with_suffix('.safetensors')}."
        )
    clock = _keys_in(keys)
    loaded = load(field)
    if not loaded.times:
        raise ValueError(f"retime {field}: the field does not depend on time; there is nothing to retime.")
    if loaded.times > 1:
        raise ValueError(
            f"retime {field}: the field has {loaded.times} times or parameters; fix all but one first: levelflow slice "
            f"{field} --time {','.join([':'] + ['0.5'] * (loaded.times - 1))} -o ..."
        )
    retimed = Retimed(loaded, clock, ease=ease)
    retimed.provenance = {"verb": "retime", "input": str(field)}
    output.parent.mkdir(parents=True, exist_ok=True)
    save(retimed, output)
    first, last = min(clock), max(clock)
    closing = "; the last is the first again" if retimed.loops else ""
    typer.echo(f"{output}: {len(clock)} keys, t from {first:g} to {last:g}{closing}")


def _keys_in(text: str) -> dict[float, float]:
    """`0:0,1:0.5,2:0.5,3:1`."""
    try:
        pairs = [(float(new), float(old)) for new, old in (part.split(":") for part in text.split(","))]
    except ValueError:
        pairs = []
    keys = dict(pairs)
    if len(keys) < 2 or not all(math.isfinite(value) for pair in pairs for value in pair):
        raise ValueError(f"--keys {text}: give two times or more, each as new:old: 0:0,1:0.5,2:0.5,3:1.")
    if len(keys) < len(pairs):
        raise ValueError(f"--keys {text}: a new time is there twice; give each once.")
    return keys
