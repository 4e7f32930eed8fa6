"""The manual of settings is made from their definitions."""

from tables import settings_table

from raybatch_addon.core.settings.settings import SETTINGS


def test_the_manual_is_up_to_date():
    assert settings_table.main(["--check"]) == 0, "run python scripts/tables/settings_table.py"


def test_every_setting_is_in_it_once():
    text = settings_table.settings_tables()
    for name in SETTINGS:
        assert text.count(f"\n| `{name}` |") == 1
    for name, info in SETTINGS.items():
        assert text.count(f"\n- `{name}`\n  - `") == (1 if info.choices else 0)


def test_a_manual_that_is_not_up_to_date_is_found_and_mended(tmp_path, monkeypatch, capsys):
    whole = settings_table.MANUAL.read_text(encoding="utf-8")
    copy = tmp_path / "tuning.md"
    monkeypatch.setattr(settings_table, "MANUAL", copy)
    copy.write_text(whole.replace("| `queue_size` |", "| `queue_length` |"), encoding="utf-8")
    assert (
        settings_table.main(["--check"]) == 1
        and "run python scripts/tables/settings_table.py" in capsys.readouterr().err
    )
    assert settings_table.main([]) == 0 and copy.read_text(encoding="utf-8") == whole
