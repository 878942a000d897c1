"""Settings: flags over environment over file over defaults, each with its source."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomend.errors import InputError
from robomend.settings import Settings, load, shown


def test_flags_win_over_environment_over_file_over_defaults(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_text("port: 1\nburst: 2\nlog_level: debug\n")
    environment = {"ROBOMEND_PORT": "3", "ROBOMEND_BURST": "4", "ROBOMEND_OTHER": "not ours"}
    settings, sources = load({"port": 5, "host": None}, environment, file)
    assert (settings.port, settings.burst, settings.log_level) == (5, 4, "debug")
    assert sources["port"] == "flag"
    assert sources["burst"] == "environment ROBOMEND_BURST"
    assert sources["log_level"] == str(file)
    assert sources["host"] == "default"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("prot: 1", "prot"),
        ("port: -1", "port"),
        ("[1]", "mapping"),
        ("a: [", "YAML"),
        ("max_nesting: 3", "max_nesting"),
        ("robomend: 1\nname: m", "this is a model, and settings"),
    ],
)
def test_what_is_wrong_is_said_with_its_source(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        load({}, {}, file)
    assert str(file) in str(caught.value)


def test_a_missing_file_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml"):
        load({}, {}, tmp_path / "none.yaml")


def test_an_empty_file_sets_nothing(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_text("# nothing\n")
    assert set(load({}, {}, file)[1].values()) == {"default"}


def test_lists_come_from_the_environment_by_commas() -> None:
    settings, _ = load({}, {"ROBOMEND_ALLOWED_HOSTS": "a.lan,b.lan"}, None)
    assert settings.allowed_hosts == ("a.lan", "b.lan")


def test_a_password_is_not_shown() -> None:
    settings = Settings.model_validate({"database": "postgresql://u:secret@h/d"})
    assert "secret" not in str(shown(settings))
    assert "secret" not in repr(settings)
