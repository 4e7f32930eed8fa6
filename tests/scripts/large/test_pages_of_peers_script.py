"""The script that measures pages in peers' memory: what it runs on one device, and that films are compared."""

import json

import numpy as np
import pytest
from several_devices import pages_of_peers

from tests.support import wide_trees
from tests.support.under_test import DEVICE


@pytest.fixture
def report(tmp_path, monkeypatch):
    positions, triangles = wide_trees.sphere(40)
    np.savez(tmp_path / "ball.npz", v=positions.astype(np.float32), f=triangles.astype(np.int32))
    written = tmp_path / "report.json"
    arguments = [str(tmp_path / "ball.npz"), "--grid", "2", "--budget", "0.3", "--device", DEVICE, "--pixels", "256"]
    arguments += ["--samples", "2", "--bounces", "1", "--runs", "1", "--memory", "--json", str(written)]

    def run() -> tuple[int, dict]:
        monkeypatch.setattr("sys.argv", ["pages_of_peers.py", *arguments])
        return pages_of_peers.main(), json.loads(written.read_text())

    return run


def test_stores_are_rendered_in_turn_and_give_one_film(report, monkeypatch):
    code, found = report()
    assert code == 0 and list(found["renders"]) == ["PEERS", "HOST", "HOST, one device", "in memory"]
    assert found["apart"] == "one device renders" and found["copies"] == {}
    assert all(row["same"] and len(row["seconds"]) == 1 for row in found["renders"].values())
    assert found["renders"]["PEERS"]["store"] == "HOST" and found["renders"]["in memory"]["store"] is None
    assert any("not PEERS" in text for text in found["renders"]["PEERS"]["warnings"])
    monkeypatch.setattr(pages_of_peers, "differing_passes", lambda mine, other: ["Combined"])
    assert report()[0] == 1
