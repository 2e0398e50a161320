"""Who may import whom, and what no module may do: read from the sources, nothing is run."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

FLOORS = (
    ("__main__",),
    ("cli",),
    ("commands", "study_commands"),
    ("farm_commands", "detached"),
    ("command_parts",),
    ("serve",),
    ("trade", "reproduce", "bundle"),
    ("bake", "farm", "standin", "train", "evaluate", "info", "doctor", "data_report"),
    ("bake_report", "shot_models", "claims"),
    ("frame", "sight", "picture_memory"),
    ("blur",),
    ("model_store", "presets"),
    ("grid_actor", "exact_actor", "formats"),
    ("grid_device", "grid_growth", "grid_checks"),
    ("grid_view", "grid_trace"),
    ("grid_inputs", "render.tracing"),
    ("grid_model", "exact"),
    ("render", "exact_shape"),
    ("upsampling", "adaptive", "samples"),
    ("actor", "tensor_reader"),
    ("deform", "methods"),
    ("data",),
    ("field", "figure"),
    ("skeleton", "camera"),
    ("kernels",),
    ("command_line",),
    ("study_line",),
    ("training_line",),
    (
        "settings",
        "geometry",
        "passes",
        "cryptomatte",
        "progress",
        "process",
        "launch",
        "arguments",
        "owner",
        "memory",
        "journal",
        "plain_arrays",
    ),
    ("plain_json",),
)
"""chona_model from the top floor down.  A module imports from lower floors, or from its own package.

A model is drawn in two stages: ``render``'s bounds, occupancy and sampling know no model and lie under the models; what
walks rays through a model (``render.tracing``) lies above them.
"""

NOT_IN_THE_MODEL = {"bpy", "bpy_extras", "mathutils", "gpu", "chona_blender"}
IN_BLENDER = {"bpy", "bpy_extras", "mathutils", "gpu", "gpu_extras", "blf", "addon_utils", "bl_operators", "numpy"}
FORBIDDEN_CALLS = {
    "eval": "text is never run",
    "exec": "text is never run",
    "os.system": "processes are started from lists",
    "os.popen": "processes are started from lists",
    "pickle.load": "pickles run what they hold; see data/restricted_pickle.py",
    "pickle.loads": "pickles run what they hold; see data/restricted_pickle.py",
    "torch.load": "pickles run what they hold; models are safetensors",
    "numpy.nan_to_num": "a NaN is found and reported, never painted over",
    "torch.nan_to_num": "a NaN is found and reported, never painted over",
}
FORBIDDEN_METHODS = {"nan_to_num", "nan_to_num_"}


def sources(package: str) -> list[Path]:
    """A package's modules."""
    found = sorted((ROOT / package).rglob("*.py"))
    assert found, f"no sources of {package}"
    return found


def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"), str(path))


def module_name(path: Path) -> str:
    """``chona_model.kernels.grid``; a package has its own name."""
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(path: Path, tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Every imported module with its line, also inside functions; relative imports made absolute."""
    package = module_name(path).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) - node.level + 1] if node.level else []
            name = ".".join([*start, *([node.module] if node.module else [])])
            for alias in node.names:
                below = ROOT.joinpath(*name.split("."), alias.name)
                is_module = below.is_dir() or below.with_suffix(".py").is_file()
                yield (f"{name}.{alias.name}" if is_module else name), node.lineno


def at_import(tree: ast.Module) -> ast.Module:
    """What runs when a module is imported: without functions and without what only type checkers see."""

    class Strip(ast.NodeTransformer):
        def visit_FunctionDef(self, _node: ast.FunctionDef) -> None:
            return None

        def visit_AsyncFunctionDef(self, _node: ast.AsyncFunctionDef) -> None:
            return None

        def visit_If(self, node: ast.If) -> ast.If | None:
            return None if "TYPE_CHECKING" in ast.unparse(node.test) else node

    return Strip().visit(tree)


def floor_of(module: str) -> tuple[int, str]:
    """The floor's number, 0 at the top, and the entry of FLOORS that the longest part of the name matches."""
    name = module.removeprefix("chona_model").removeprefix(".")
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        head = ".".join(parts[:length])
        for number, floor in enumerate(FLOORS):
            if head in floor:
                return number, head
    raise LookupError(f"{module} has no floor; give it one in FLOORS")


def goes_up(importer: str, target: str) -> bool:
    """Whether an import breaks the order of the floors."""
    if target == "chona_model":
        return False
    (from_floor, from_unit), (to_floor, to_unit) = floor_of(importer), floor_of(target)
    same_package = from_unit.partition(".")[0] == to_unit.partition(".")[0]
    return to_floor < from_floor or (to_floor == from_floor and not same_package)


def test_imports_in_the_model_go_down_a_floor() -> None:
    wrong = []
    for path in sources("chona_model"):
        module = module_name(path)
        if module == "chona_model":
            continue
        for target, line in imported(path, parsed(path)):
            if target.partition(".")[0] == "chona_model" and goes_up(module, target):
                wrong.append(f"{path.relative_to(ROOT)}:{line}: {module} imports {target}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("package", ["chona_model", "chona_blender"])
def test_no_module_imports_itself_roundabout(package: str) -> None:
    known = {module_name(path): path for path in sources(package)}
    edges = {
        name: {target for target, _ in imported(path, at_import(parsed(path))) if target in known and target != package}
        for name, path in known.items()
    }
    done: set[str] = set()

    def walk(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, " -> ".join([*trail[trail.index(name) :], name])
        if name in done:
            return
        for target in sorted(edges[name] - {name}):
            walk(target, (*trail, name))
        done.add(name)

    for name in known:
        walk(name, ())


def test_the_model_knows_nothing_of_blender() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in sources("chona_model")
        for name, line in imported(path, parsed(path))
        if name.partition(".")[0] in NOT_IN_THE_MODEL
    ]
    assert not wrong, "\n".join(wrong)


def test_blenders_process_has_bpy_and_numpy_alone() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in sources("chona_blender")
        for name, line in imported(path, parsed(path))
        if name.partition(".")[0] not in {*IN_BLENDER, *sys.stdlib_module_names, "chona_blender"}
    ]
    assert not wrong, "\n".join(wrong)


def dotted(node: ast.expr, aliases: dict[str, str]) -> str:
    """``np.nan_to_num`` as ``numpy.nan_to_num``; empty for calls of anything but names."""
    if isinstance(node, ast.Name):
        return aliases.get(node.id, node.id)
    if isinstance(node, ast.Attribute):
        head = dotted(node.value, aliases)
        return f"{head}.{node.attr}" if head else ""
    return ""


def aliases_of(tree: ast.Module) -> dict[str, str]:
    """Local name -> full name of what is imported."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.asname: alias.name for alias in node.names if alias.asname}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("package", ["chona_model", "chona_blender", "scripts"])
def test_nothing_dangerous_is_called_and_nothing_is_swallowed(package: str) -> None:
    wrong = []
    for path in sources(package):
        tree = parsed(path)
        aliases, where = aliases_of(tree), path.relative_to(ROOT)
        for node in ast.walk(tree):
            if isinstance(node, ast.ExceptHandler) and node.type is None:
                wrong.append(f"{where}:{node.lineno}: a bare except")
            elif isinstance(node, ast.Call):
                name = dotted(node.func, aliases)
                method = node.func.attr if isinstance(node.func, ast.Attribute) else ""
                if name in FORBIDDEN_CALLS or method in FORBIDDEN_METHODS:
                    reason = FORBIDDEN_CALLS.get(name, FORBIDDEN_CALLS["torch.nan_to_num"])
                    wrong.append(f"{where}:{node.lineno}: {name or method}: {reason}")
                if any(word.arg == "shell" and ast.unparse(word.value) != "False" for word in node.keywords):
                    wrong.append(f"{where}:{node.lineno}: a process through a shell")
                if any(word.arg == "allow_pickle" and ast.unparse(word.value) != "False" for word in node.keywords):
                    wrong.append(f"{where}:{node.lineno}: numpy may unpickle here")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    ("importer", "target", "wrong"),
    [
        ("chona_model.camera", "chona_model.kernels.grid", False),
        ("chona_model.kernels.grid", "chona_model.camera", True),
        ("chona_model.camera", "chona_model.skeleton", True),
        ("chona_model.data.behave", "chona_model.data.dataset", False),
        ("chona_model.render.tracing", "chona_model.grid_model", False),
        ("chona_model.render.posed", "chona_model.grid_model", True),
        ("chona_model.train.run", "chona_model.cli", True),
        ("chona_model.train.run", "chona_model.bake", True),
    ],
)
def test_the_floors_tell_up_from_down(importer: str, target: str, wrong: bool) -> None:
    assert goes_up(importer, target) is wrong
