"""scripts/benchmark.py render --against devices: several devices beside fewer of them."""

import json
from pathlib import Path

import benchmark
import warp as wp
from benchmarking.against import devices
from benchmarking.tables import devices_text

from raybatch_addon.core import session as session_module
from raybatch_addon.core.session import Session
from raybatch_addon.core.session_device import SessionDevice
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support.benchmark_scenes import save_bowl


def test_several_devices_are_measured_beside_fewer(tmp_path, capfd, monkeypatch):
    """The CPU stands for three devices."""
    cpu = wp.get_device("cpu")

    def session_of(names: str, settings: RenderSettings, folder: Path) -> Session:
        session = Session("cpu", settings, folder)
        session._at = [SessionDevice(cpu) for _ in names.split(",")]
        return session

    monkeypatch.setattr(devices, "find_devices", lambda names: [cpu] * 3)
    monkeypatch.setattr(devices, "Session", session_of)
    monkeypatch.setattr(session_module, "SHARED_PATHS_LEAST", 1)
    options = ["render", str(save_bowl(tmp_path)), "--samples", "2", "--size", "32x24", "--threads", "1", "--runs", "2"]
    assert benchmark.main([*options, "--against", "devices", "--device", "ALL", "--set", "tile_size=8", "--json"]) == 0
    report = json.loads(capfd.readouterr().out)
    assert [len(each["devices"]) for each in report["several"]] == [1, 2, 3]
    assert report["films"] == {"compared": 3 * (1 + 2), "equal": True, "differences": []}
    one, *others = report["several"]
    assert one["speedup"] == one["speedup_whole"] == 1 and one["paths"] == [2 * 32 * 24]
    assert all(each["speedup"] > 0 and each["whole"]["runs"] == 2 for each in others)
    assert all(0 <= each["idle"] < 1 for each in report["several"])
    assert "films are equal bit for bit" in devices_text(report)


def test_devices_are_idle_where_they_are_not_at_a_tile():
    def idle(render: float, *working: float) -> float:
        rows = [{"seconds_working": each} for each in working]
        return devices.idle({"seconds": {"render": render}, "devices": rows})

    assert idle(2.0, 2.0, 1.0) == 0.25 and idle(1.0, 1.0) == 0 and idle(0.0, 0.0) == 0
    assert devices.device_counts(8) == [1, 2, 4, 8] and devices.device_counts(3) == [1, 2, 3]


def test_unlike_devices_are_refused(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(devices, "find_devices", lambda names: [wp.get_device("cpu")] * 2)
    monkeypatch.setattr(devices, "is_alike", lambda *_: False)
    options = ["render", str(save_bowl(tmp_path)), "--against", "devices", "--device", "cuda:0,cpu"]
    assert benchmark.main(options) == 1
    assert "unlike devices do not render the same bits" in capfd.readouterr().err
