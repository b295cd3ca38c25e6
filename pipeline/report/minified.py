"""A script without blanks and comments, and without what else a browser does not need."""

import re
from collections.abc import Iterator

import rjsmin

#: A regular expression begins after one of these, else a slash divides.
_BEFORE = r"(?:(?<=[(,=:\[!&|?{};+\-*%~^<>\n])|(?<=\breturn)|(?<=\btypeof))"
_REGULAR = _BEFORE + r"/(?:\\.|\[(?:\\.|[^\]\\\n])*\]|[^/\\\[\n])+/[a-z]*"
_QUOTED = r'"(?:\\.|[^"\\\n])*"|' + r"'(?:\\.|[^'\\\n])*'"

#: What ends a piece of code: a literal, the beginning of a template, or braces, which
#: are counted; and what ends the text of a template.
_IN_CODE = re.compile(rf"(?P<literal>{_QUOTED}|{_REGULAR})|[`{{}}]")
_IN_TEXT = re.compile(r"\\.|`|\$\{", re.S)

#: A statement that does nothing at the end of a block, whose semicolon is all of it;
#: parentheses without others in them.
_EMPTY = re.compile(r"(?<![.\w$])(?:(?:for|if|while|with)\([^()]*\)|else);}")
_INNERMOST = re.compile(r"\([^()]*\)")

#: After a block no line need end before another statement.
_LINE_END = re.compile(r"}\n(?=function |class |if|for|const |let |})")


def minified(script: str) -> str:
    """A script in fewer bytes that does the same; its texts and regular expressions
    stay as they are.

    Raises
    ------
    ValueError
        If a block ends in an empty statement, which would be lost, or in what looks like
        one: the condition of a `do`.
    """
    pieces = [*_pieces(rjsmin.jsmin(script))]
    _check_statements("".join(piece if is_code else "0" for is_code, piece in pieces))
    return "".join(_shorter(piece) if is_code else piece for is_code, piece in pieces)


def _check_statements(code: str) -> None:
    """Refuse a script, without its literals, of which a block ends in an empty
    statement.
    """
    previous = ""
    while code != previous:
        if found := _EMPTY.search(code):
            raise ValueError(f"`{found[0]}` is an empty statement; write a block.")
        # From within, so that in the end each head of a statement holds no other.
        previous, code = code, _INNERMOST.sub("0", code)


def _shorter(code: str) -> str:
    """Code without the ends of lines and statements that a brace makes needless."""
    return _LINE_END.sub("}", code).replace(";}", "}")


def _pieces(script: str) -> Iterator[tuple[bool, str]]:
    """A script in pieces, each with whether it is code; of a template, the expressions
    are.
    """
    begin = place = 0
    is_code = True
    # Braces open in the expressions around: of the script, of templates in it, …
    open_braces = [0]
    while found := (_IN_CODE if is_code else _IN_TEXT).search(script, place):
        place = found.end()
        token = found[0]
        if token.startswith("\\"):
            continue

        if is_code and token in "{}":
            open_braces[-1] += 1 if token == "{" else -1
            if open_braces[-1] >= 0:
                continue
            # The expression of a template ends, and its text goes on.
            open_braces.pop()
        elif token == "${":
            open_braces.append(0)

        end = place if not is_code else found.start()
        yield is_code, script[begin:end]
        begin = end
        if is_code and found["literal"]:
            yield False, token
            begin = place
        else:
            is_code = not is_code

    yield is_code, script[begin:]
