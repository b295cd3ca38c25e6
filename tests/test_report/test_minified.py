import pytest

from gaitsweep.pipeline.report.minified import minified


@pytest.mark.parametrize(
    "literal",
    [
        '"a;}"',
        "'b;}\\'c;}'",
        "/[/;}]d;}/g",
        "`e;}\n}\nif`",
        "`f;}${g(`h;}`)}i;}`",
        "`j${{k: '`;}'}}l;}`",
    ],
)
def test_texts_and_regular_expressions_stay_as_they_are(literal):
    assert literal in minified(f"const a = {literal};\nif (b) {{ c; }}\nif (d) e;")


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("if (a) { b; }\nfor (;;) {}", "if(a){b}for(;;){}"),
        ("const a = b / c; const d = { e: f / g };", "const a=b/c;const d={e:f/g};"),
        ("a = `${()=>{b;}}`;", "a=`${()=>{b}}`;"),
        ("a = () => {}\n(b)", "a=()=>{}\n(b)"),
    ],
)
def test_code_loses_what_a_brace_makes_needless(code, expected):
    assert minified(code) == expected


@pytest.mark.parametrize(
    "statement",
    [
        "while (a(b(1)));",
        "for (; a('x)'););",
        "if (a) b(); else;",
        "if (/[)]/.test(a));",
    ],
)
def test_an_empty_statement_at_the_end_of_a_block_is_refused(statement):
    with pytest.raises(ValueError, match="empty statement"):
        minified(f"function f() {{ {statement} }}")


@pytest.mark.parametrize("statement", ["while (a) { b(); }", "a(b(c)); d.if(e);"])
def test_other_statements_at_the_end_of_a_block_are_taken(statement):
    minified(f"function f() {{ {statement} }}")
