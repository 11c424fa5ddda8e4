"""Catalogues as gettext's tools write them, read without those tools."""

from pathlib import Path

import pytest

from lmeasure.text.catalogue import Writer, read_catalogue

HEAD = 'msgid ""\nmsgstr ""\n"Language: ru\\n"\n\n'


def test_texts_in_pieces_with_comments_and_escapes(tmp_path: Path) -> None:
    path = tmp_path / "some.po"
    first = '#, python-format\nmsgid "a \\"b\\""\nmsgstr ""\n"один\\n"\n"два \\\\ три"\n'
    path.write_text("# by hand\n" + HEAD + first + '\nmsgid "c"\nmsgstr "г"\n', encoding="utf-8")
    assert list(read_catalogue(path).items()) == [('a "b"', "один\nдва \\ три"), ("c", "г")]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('msgid "a"\nmsgid "b"\n', 6),
        ('msgstr "a"\n', 5),
        ('msgctxt "x"\n', 5),
        ('msgid "a"\nmsgid_plural "b"\n', 6),
        ('msgid "a"\nmsgstr "b\n', 6),
        ("words\n", 5),
    ],
)
def test_anything_else_is_refused_by_file_and_line(text: str, line: int, tmp_path: Path) -> None:
    path = tmp_path / "some.po"
    path.write_text(HEAD + text)
    with pytest.raises(ValueError, match=rf"some\.po:{line}: no key, text or comment"):
        read_catalogue(path)


@pytest.mark.parametrize(
    ("language", "text", "said"),
    [
        ("en", "{n:d} {n:pose|poses}", "0 poses, 1 pose, 2 poses, 5 poses, 11 poses, 21 poses, 112 poses"),
        ("ru", "{n:d} {n:поза|позы|поз}", "0 поз, 1 поза, 2 позы, 5 поз, 11 поз, 21 поза, 112 поз"),
    ],
)
def test_a_word_agrees_with_its_count(language: str, text: str, said: str) -> None:
    assert ", ".join(Writer(language).vformat(text, (), {"n": n}) for n in (0, 1, 2, 5, 11, 21, 112)) == said
