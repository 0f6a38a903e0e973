"""Comments beside the fields of a class, with their units, as the fields' documentation.

An extension of Griffe, which reads docstrings alone. `x: Series  # m, north` has its unit in a
comment; a comment on lines of its own above a field counts where none stands beside it.
"""

import ast
import io
import tokenize

import griffe


class FieldComments(griffe.Extension):
    """Gives each field of a class without a docstring its comment."""

    def on_attribute_instance(
        self, *, node: ast.AST | griffe.ObjectNode, attr: griffe.Attribute, **kwargs: object
    ) -> None:
        """Read the comments of the lines that a field takes."""
        del node, kwargs
        if attr.docstring is not None or not isinstance(attr.parent, griffe.Class):
            return
        if attr.lineno is None or attr.endlineno is None or attr.name.startswith("_"):
            return
        lines = attr.lines_collection[attr.filepath]
        told = _comments(lines[attr.lineno - 1 : attr.endlineno])
        above = attr.lineno - 2
        while not told and above >= 0 and lines[above].strip().startswith("#"):
            above -= 1
        told = told or _comments(lines[above + 1 : attr.lineno - 1])
        if told:
            attr.docstring = griffe.Docstring(told, parent=attr)


def _comments(lines: list[str]) -> str:
    code = "\n".join(line.strip() for line in lines) + "\n"
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(code).readline))
    except tokenize.TokenError:
        return ""
    return " ".join(t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT)
