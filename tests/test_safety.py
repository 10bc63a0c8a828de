"""Nothing in a file of a user is executed but a file of effects: no pickle is read, and no text is evaluated."""

import ast
import time
from pathlib import Path

import pytest

from capsbayes.errors import InputError
from capsbayes.quantity import Quantity

SOURCE = Path(__file__).parents[1] / "src" / "capsbayes"
# copies within one program: tasks sent to worker processes, and the check that a user's own law can be sent
COPIES = {"run.py": {"cloudpickle"}, "testing.py": {"pickle"}}
ASKED_FOR = {"cli/effects_file.py": {"compile", "exec", "cloudpickle"}}  # the file that --effects names is run
READS_OBJECTS = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}
EVALUATES = {"eval", "exec", "compile", "__import__"}


def dangers(node):
    """Yield the modules and calls of a node that could run what a file holds."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
        yield from READS_OBJECTS & {module.split(".")[0] for module in modules}
    elif isinstance(node, ast.Call):
        if isinstance(node.func, ast.Name) and node.func.id in EVALUATES:
            yield node.func.id
        for word in node.keywords:
            if word.arg == "allow_pickle" and not (isinstance(word.value, ast.Constant) and word.value.value is False):
                yield "allow_pickle"


def test_no_module_unpickles_or_evaluates():
    files = {file.relative_to(SOURCE).as_posix(): ast.parse(file.read_text("utf-8")) for file in SOURCE.rglob("*.py")}
    found = {name: {danger for node in ast.walk(tree) for danger in dangers(node)} for name, tree in files.items()}
    assert len(files) > 100
    assert {name: words for name, words in found.items() if words} == COPIES | ASKED_FOR


@pytest.mark.parametrize(
    "text", ["6.2 +/- 0.06 mm/s * (9**9**9)", "6.2 +/- 0.06 mm/s * (1+1) ** 2", "__import__('os')"]
)
def test_a_quantity_is_not_evaluated(text):
    begin = time.perf_counter()
    with pytest.raises(InputError, match="expected a text in m/s"):
        Quantity.read(text, where="x.toml", key="velocity", units=("m/s",), example="6.2 +/- 0.06 mm/s")
    assert time.perf_counter() - begin < 5.0
