"""Nothing in a file of a user is executed but a file of effects: no pickle is read, and no text is evaluated."""

import ast
from pathlib import Path

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
    texts = {file.relative_to(SOURCE).as_posix(): file.read_text("utf-8") for file in SOURCE.rglob("*.py")}
    assert len(texts) > 100
    words = READS_OBJECTS | EVALUATES | {"allow_pickle"}
    trees = {name: ast.parse(text) for name, text in texts.items() if any(word in text for word in words)}
    found = {name: {danger for node in ast.walk(tree) for danger in dangers(node)} for name, tree in trees.items()}
    assert {name: words for name, words in found.items() if words} == COPIES | ASKED_FOR
