"""The house rules that can be read off the source: who imports whom, and what no file may do."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import levelflow

PACKAGE = Path(__file__).resolve().parent.parent / "levelflow"

# Level 0, 1, 2, ... A module imports only from levels below its own, never sideways. A folder has one level; within it
# the steps below decide. A new module is placed here, above all that it imports and as low as that allows.
LEVELS = (
    ("_version", "jets"),
    ("boxes", "curvature"),
    ("fields", "optimising"),
    ("keyframed", "networks", "shapes", "minimising", "retimed"),
    ("equations", "conditions", "elasticity", "extraction", "handles", "measures", "progress", "steepness"),
    ("averaging", "rendering", "transported"),
    ("motion",),
    ("bending", "flows"),
    ("fitting", "solving", "evolution", "deformation", "filtering", "recovery"),
    ("saving", "export", "suite"),
    ("viewer",),
    ("cli",),
    ("__main__",),
)
STEPS = {
    "cli": (
        ("names", "options"),
        ("lifting", "masking", "retiming", "running", "showing", "taking"),
        ("deforming", "families", "filtering", "following", "viewing"),
        ("commands",),
    ),
    "equations": (
        ("equation", "masks"),
        (
            "curvature",
            "eikonal",
            "family",
            "features",
            "heat",
            "morph",
            "stationary",
            "transport",
            "unconstrained",
            "volume",
            "willmore",
        ),
        ("approach", "regional", "simplicial"),
        ("commuting", "described"),
    ),
    "export": (
        ("frames", "normal_motion", "printing"),
        ("snapshots",),
        ("painting", "ply", "scene", "sequences", "tracking", "volumes"),
        ("gltf", "paraview", "usd", "vdb"),
    ),
    "flows": (
        ("densifying", "flow", "laplacian", "normals"),
        ("curvature", "descent", "editing", "prescribed", "volume"),
    ),
    "handles": (("regions",), ("handle",), ("reading",)),
    "networks": (("lipschitz", "siren"), ("invertible", "lifting", "periodic")),
    "rendering": (
        ("camera", "colours", "quantities"),
        ("hits",),
        ("rasterising", "tracing"),
        ("differentiable", "shading"),
        ("curves",),
        ("images",),
        ("film",),
    ),
    "shapes": (
        ("shape",),
        ("reading", "sampling", "simplices", "writing"),
        ("distance",),
        ("analytic", "cloud", "combined", "implicit", "level", "mesh", "tabulated"),
    ),
    "suite": (("solids", "suite"), ("energies", "films", "parameters"), ("cases",)),
    "viewer": (("viewed",), ("packing",), ("frames",), ("editing",), ("page",), ("server",)),
}
LONGEST = 500
VAGUE = {"base", "common", "helper", "helpers", "manager", "misc", "tools", "util", "utils"}
FORBIDDEN = {
    "print": "let the caller say it: return it, or take `on_step`",
    "random.seed": "take `generator`",
    "np.random.seed": "take `generator`",
    "torch.manual_seed": "take `generator`",
    "torch.set_default_device": "follow the device of the inputs",
    "torch.set_default_dtype": "follow the dtype of the inputs",
}


def _name(file: Path) -> str:
    """`levelflow.shapes.mesh`, or `levelflow.shapes` for its `__init__.py`."""
    parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {_name(file): file for file in sorted(PACKAGE.rglob("*.py"))}


def _place(module: str) -> tuple[int, str, int]:
    """The level of a module, its name within the level, and its step there; above all steps for a folder itself."""
    top, _, rest = module.removeprefix("levelflow.").partition(".")
    level = next((i for i, names in enumerate(LEVELS) if top in names), None)
    if level is None:
        pytest.fail(f"{module} has no level: place {top!r} in LEVELS of {__file__}, above all that it imports.")
    steps = STEPS.get(top, ())
    if not rest:
        return level, top, len(steps)
    step = next((i for i, names in enumerate(steps) if rest in names), None)
    if step is None:
        pytest.fail(f"{module} has no step: place {rest!r} in STEPS[{top!r}] of {__file__}, above all that it imports.")
    return level, top, step


def _may_import(importer: str, imported: str) -> bool:
    """Whether the levels allow it. Nothing in the package imports the public names of `levelflow` itself."""
    if imported == "levelflow":
        return False
    level, top, step = _place(importer)
    other_level, other_top, other_step = _place(imported)
    return other_level < level or (other_top == top and other_step < step)


def _imports(source: str, package: str) -> Iterator[tuple[str, int]]:
    """The modules of levelflow that a source imports, wherever in it, and the lines."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            home = "." * node.level + (node.module or "")
            home = importlib.util.resolve_name(home, package) if node.level else home
            inner = (f"{home}.{alias.name}" for alias in node.names)
            names = [name if name in FILES else home for name in inner]
        else:
            continue
        for name in dict.fromkeys(names):
            if name.partition(".")[0] == "levelflow":
                yield name, node.lineno


def _package(module: str) -> str:
    return module if FILES[module].name == "__init__.py" else module.rpartition(".")[0]


@pytest.mark.parametrize("module", [module for module in FILES if module != "levelflow"])
def test_a_module_imports_only_from_lower_levels(module: str) -> None:
    wrong = [
        f"{FILES[module]}:{line}: {module} imports {imported}"
        for imported, line in _imports(FILES[module].read_text(), _package(module))
        if not _may_import(module, imported)
    ]
    assert not wrong, "\n".join(["not from a lower level (see LEVELS and STEPS):", *wrong])


def test_imports_are_found_wherever_they_stand() -> None:
    source = """
import levelflow.jets as jets, torch
from levelflow import shapes, fit
if TYPE_CHECKING:
    from levelflow.shapes.mesh import Mesh
def f():
    from . import mesh
    from ..boxes import Box
"""
    found = [name for name, _ in _imports(source, "levelflow.shapes")]
    assert sorted(found) == sorted(
        [
            "levelflow.jets",
            "levelflow.shapes",
            "levelflow",
            "levelflow.shapes.mesh",
            "levelflow.shapes.mesh",
            "levelflow.boxes",
        ]
    )


@pytest.mark.parametrize(
    ("importer", "imported", "allowed"),
    [
        ("shapes.mesh", "boxes", True),
        ("shapes.mesh", "shapes.distance", True),
        ("shapes", "shapes.mesh", True),
        ("cli", "shapes", True),
        ("boxes", "curvature", False),
        ("shapes.distance", "minimising", False),
        ("shapes.distance", "shapes.mesh", False),
        ("shapes.mesh", "shapes.analytic", False),
        ("boxes", "cli", False),
    ],
)
def test_levels_forbid_sideways_and_upwards(importer: str, imported: str, allowed: bool) -> None:
    assert _may_import(f"levelflow.{importer}", f"levelflow.{imported}") is allowed


@pytest.mark.parametrize("module", ["levelflow.news", "levelflow.shapes.news"])
def test_a_module_without_a_place_is_told_where_to_go(module: str) -> None:
    with pytest.raises(pytest.fail.Exception, match=r"place 'news' in (LEVELS|STEPS\['shapes'\])"):
        _place(module)


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import sys, levelflow; print(*sorted({'torch', 'numpy', 'trimesh', 'scipy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


@pytest.mark.parametrize("name", levelflow.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(levelflow, name) is not None
    assert name in dir(levelflow)


@pytest.mark.parametrize("module", FILES)
def test_every_public_name_has_a_docstring(module: str) -> None:
    tree = ast.parse(FILES[module].read_text())
    bare = [] if ast.get_docstring(tree) else [f"{FILES[module]}:1: the module"]
    bare += [
        f"{FILES[module]}:{node.lineno}: {node.name}"
        for node in tree.body
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        if not node.name.startswith("_") and not ast.get_docstring(node)
    ]
    assert not bare, "\n".join(["no docstring:", *bare])


@pytest.mark.parametrize("module", FILES)
def test_nothing_prints_seeds_or_sets_defaults(module: str) -> None:
    calls = (node for node in ast.walk(ast.parse(FILES[module].read_text())) if isinstance(node, ast.Call))
    named = [(ast.unparse(call.func), call.lineno) for call in calls]
    wrong = [
        f"{FILES[module]}:{line}: {name}(...): {FORBIDDEN[name]}"
        for name, line in named
        if name in FORBIDDEN and not (name == "print" and module == "levelflow.cli")
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("module", FILES)
def test_a_file_is_one_idea_with_a_name(module: str) -> None:
    assert not VAGUE & set(module.split(".")), f"{FILES[module]}: name it for what it holds"
    lines = len(FILES[module].read_text().splitlines())
    assert lines <= LONGEST, f"{FILES[module]} has {lines} lines: it holds more than one idea; split it"
