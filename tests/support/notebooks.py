"""A runner of notebooks without a server: it runs the code cells in one namespace and keeps their output.

`python tests/support/notebooks.py NOTEBOOK` writes the output into the file, as a notebook server would.
"""

import ast
import base64
import io
import sys
from contextlib import redirect_stdout
from pathlib import Path

import nbformat


def run(path):
    """Run all code cells; return the notebook with their output."""
    import matplotlib

    matplotlib.use("agg")
    # Close open figures of earlier code, which are not output of a cell.
    _pictures()
    notebook, space = nbformat.read(path, as_version=4), {"__name__": "__main__"}
    count = 0
    for cell in notebook.cells:
        if cell.cell_type == "code":
            count += 1
            cell.outputs, cell.execution_count = _outputs(cell.source, space, count), count
    return notebook


def _outputs(source, space, count):
    tree, printed, value = ast.parse(source), io.StringIO(), None
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with redirect_stdout(printed):
        exec(compile(tree, "<cell>", "exec"), space)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), space)
    outputs = []
    if printed.getvalue():
        outputs.append(nbformat.v4.new_output("stream", name="stdout", text=printed.getvalue()))
    pictures = _pictures()
    if value is not None and not pictures:
        outputs.append(
            nbformat.v4.new_output("execute_result", data={"text/plain": repr(value)}, execution_count=count)
        )
    return outputs + [nbformat.v4.new_output("display_data", data=data) for data in pictures]


def _pictures():
    """Return the open figures as PNG, and close them."""
    from matplotlib import pyplot

    made = []
    for number in pyplot.get_fignums():
        content = io.BytesIO()
        pyplot.figure(number).savefig(content, format="png", dpi=80, metadata={"Software": None})
        made.append({"image/png": base64.b64encode(content.getvalue()).decode(), "text/plain": "<Figure>"})
        pyplot.close(number)
    return made


if __name__ == "__main__":
    for name in sys.argv[1:]:
        nbformat.write(run(name), Path(name))
