"""Write the pages that the site is built from into `build/docs`: ``python docs/prepare``, before ``mkdocs build``.

Pages stored outside docs/ are added, tables and the help of the commands are taken from the code, and equations become
MathML. What is written is plain Markdown, which needs no plugin of its own from the tool that builds the site.
"""

from __future__ import annotations

import shutil
import sys
from concurrent.futures import ThreadPoolExecutor

from equations import with_mathml
from from_code import COMMANDS, commands, with_tables
from neighbours import DOCS, NEIGHBOURS, PICTURES, RESULTS, ROOT, with_links
from notebooks import NOTEBOOKS, page_of

TARGET = ROOT / "build" / "docs"
LEFT_OUT = shutil.ignore_patterns("prepare", "*.py", "*.json", "__pycache__")


def main() -> int:
    """Write all pages anew; the exit status is 1 where an equation contains a command that is not supported."""
    shutil.rmtree(TARGET, ignore_errors=True)
    shutil.copytree(ROOT / DOCS, TARGET, ignore=LEFT_OUT)
    shutil.copytree(ROOT / RESULTS, TARGET / RESULTS, ignore=LEFT_OUT)
    for path in (*NEIGHBOURS, *PICTURES):
        (TARGET / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / path, TARGET / path)
    (TARGET / COMMANDS).write_text(commands(), encoding="utf-8")
    notebooks = sorted(NOTEBOOKS.glob("*.ipynb"))
    with ThreadPoolExecutor() as pool:  # each waits for a process of its own
        for path, (text, pictures) in zip(notebooks, pool.map(page_of, notebooks), strict=True):
            (TARGET / NOTEBOOKS.name / f"{path.stem}.md").write_text(text, encoding="utf-8")
            for name, content in pictures.items():
                (TARGET / NOTEBOOKS.name / name).write_bytes(content)
    site = {path.relative_to(TARGET).as_posix() for path in TARGET.rglob("*") if path.is_file()}
    failed = []
    for name in sorted(path for path in site if path.endswith(".md")):
        text = with_links(with_tables((TARGET / name).read_text(encoding="utf-8")), name, site)
        page, unknown = with_mathml(text)
        (TARGET / name).write_text(page, encoding="utf-8")
        failed += [f"{name}: the equation {latex!r} contains a command that is not supported" for latex in unknown]
    print("\n".join(failed), file=sys.stderr, end="\n" if failed else "")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
