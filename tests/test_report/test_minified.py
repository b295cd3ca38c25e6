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
