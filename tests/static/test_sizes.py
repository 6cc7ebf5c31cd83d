"""The check of sizes finds a long module and a long function, and neither in the tree."""

from checks.sizes import LONGER, main, too_long


def lines(count: int) -> str:
    return "def f():\n" + "    x = 1\n" * (count - 1)


def test_a_function_of_sixty_lines_passes_and_one_of_sixty_one_is_told() -> None:
    assert not list(too_long("a.py", lines(60)))
    assert list(too_long("a.py", lines(61))) == ["a.py:1: f has 61 lines; at most 60"]


def test_a_module_of_four_hundred_lines_passes_and_one_more_is_told() -> None:
    assert not list(too_long("a.py", "x = 1\n" * 400))
    assert list(too_long("a.py", "x = 1\n" * 401)) == ["a.py: 401 lines; at most 400"]


def test_only_what_is_named_may_be_longer() -> None:
    path, name = next(iter(LONGER))
    source = lines(61).replace("def f", f"def {name}")
    assert not list(too_long(path, source))
    assert list(too_long("a.py", source))


def test_the_tree_passes() -> None:
    assert main() == 0
