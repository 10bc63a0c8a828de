"""Nothing in a file of a user is executed: no pickle is read, and no text is evaluated."""

import ast
import time
from pathlib import Path

import pytest

from capsbayes.errors import InputError
from capsbayes.quantity import Quantity

SOURCE = Path(__file__).parents[1] / "src" / "capsbayes"
# copies within one program: tasks sent to worker processes, and the check that a user's own law can be sent
COPIES = {"work/workers.py": {"cloudpickle"}, "testing.py": {"pickle"}}
READS_OBJECTS = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}
EVALUATES = {"eval", "exec", "compile", "__import__"}


@pytest.mark.parametrize("file", sorted(SOURCE.rglob("*.py")), ids=lambda file: str(file.relative_to(SOURCE)))
def test_a_module_neither_unpickles_nor_evaluates(file):
    tree = ast.parse(file.read_text(encoding="utf-8"))
    modules = {
        alias.name.split(".")[0] for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names
    }
    modules |= {(node.module or "").split(".")[0] for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert modules & READS_OBJECTS <= COPIES.get(file.relative_to(SOURCE).as_posix(), set())
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        assert not (isinstance(call.func, ast.Name) and call.func.id in EVALUATES)
        unpickles = [word.value for word in call.keywords if word.arg == "allow_pickle"]
        assert all(isinstance(value, ast.Constant) and value.value is False for value in unpickles)


@pytest.mark.parametrize(
    "text", ["6.2 +/- 0.06 mm/s * (9**9**9)", "6.2 +/- 0.06 mm/s * (1+1) ** 2", "__import__('os')"]
)
def test_a_quantity_is_not_evaluated(text):
    begin = time.perf_counter()
    with pytest.raises(InputError, match="expected a text in m/s"):
        Quantity.read(text, where="x.toml", key="velocity", units=("m/s",), example="6.2 +/- 0.06 mm/s")
    assert time.perf_counter() - begin < 5.0
