"""The equation that a field was solved for, from the text of its provenance: numbers are read, code is not run."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from typing import Any

from levelflow.equations.curvature import MeanCurvature
from levelflow.equations.eikonal import Eikonal
from levelflow.equations.equation import Equation
from levelflow.equations.family import Family
from levelflow.equations.features import FeaturePreserving
from levelflow.equations.heat import Heat
from levelflow.equations.masks import BoxMask, ProductOfMasks, SphereMask
from levelflow.equations.regional import Regional
from levelflow.equations.stationary import Stationary
from levelflow.equations.transport import Constant, Rotation, Source, SumOfVelocities, Transport, Twist, VelocityField
from levelflow.equations.unconstrained import Unconstrained

_VELOCITIES = (Constant, Rotation, Source, SumOfVelocities, Twist)
_MASKS = (BoxMask, ProductOfMasks, SphereMask)
_EQUATIONS = (
    Eikonal,
    Family,
    FeaturePreserving,
    Heat,
    MeanCurvature,
    Regional,
    Stationary,
    Transport,
    Unconstrained,
)
_KNOWN: Mapping[str, Any] = {kind.__name__: kind for kind in (*_EQUATIONS, *_VELOCITIES, *_MASKS)}


def equation_of(provenance: Mapping[str, Any]) -> Equation | None:
    """The equation in `provenance["equation"]`, the `repr` of one whose parts are all numbers.

    None where there is none, or where it has parts that no text can hold: the targets of a morph, a function of one's
    own.
    """
    try:
        found = _value(ast.parse(str(provenance.get("equation", "")), mode="eval").body)
    except (SyntaxError, TypeError, ValueError, RecursionError, MemoryError):
        return None
    return found if isinstance(found, Equation) else None


def _value(node: ast.expr) -> Any:
    """Numbers, tuples, and sums and calls of what is known.

    Raises:
        ValueError: If it is anything else.
    """
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = _value(node.left), _value(node.right)
        if not isinstance(left, Equation) or not isinstance(right, Equation):
            raise ValueError(f"{ast.unparse(node)} is no sum of equations")
        return left + right
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _KNOWN:
        given = {keyword.arg or "": _value(keyword.value) for keyword in node.keywords}
        made = _KNOWN[node.func.id](*map(_value, node.args), **given)
        if isinstance(made, SumOfVelocities) and not all(isinstance(v, VelocityField) for v in made.velocities):
            raise ValueError(f"{ast.unparse(node)} is no sum of velocities")
        masks = made.masks if isinstance(made, ProductOfMasks) else (made.mask,) if isinstance(made, Regional) else ()
        if not all(isinstance(mask, _MASKS) for mask in masks):
            raise ValueError(f"{ast.unparse(node)} has a mask that is none")
        return made
    if isinstance(node, ast.Tuple):
        return tuple(map(_value, node.elts))
    if ast.unparse(node) in ("inf", "-inf"):
        return float(ast.unparse(node))
    return ast.literal_eval(node)
