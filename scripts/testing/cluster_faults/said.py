"""What the report of a render must say of a fault, by what it could know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from testing.cluster_faults.faults import KINDS, Fault

NOTICED_SECONDS = 3.0  # what happens so long before the end is in the report


@dataclass(frozen=True)
class RenderReport:
    """The events of a render's report, and when it was, by the clock of `time.monotonic` [s]."""

    events: list[dict[str, Any]]
    begun: float  # from which on its events count their seconds, or some moment later
    ended: float

    def has(self, fault: Fault, host: str, after: float = float("-inf")) -> bool:
        """Whether an event after that moment says what befell the machine `host`, or samples."""
        kinds, _ = KINDS[fault.kind]
        return any(
            each["kind"] in kinds
            and (host in each["who"] or "samples" in each["who"])
            and self.begun + each["seconds"] >= after
            for each in self.events
        )

    def there(self, host: str) -> list[tuple[float, float]]:
        """When the machine had a worker, as far as the events say so; there was one at the begin."""
        since: float | None = float("-inf")
        found = []
        for each in self.events:
            if host not in each["who"]:
                continue
            moment = self.begun + each["seconds"]
            if each["kind"] == "WORKER_CAME" and since is None:
                since = moment
            elif each["kind"] in ("WORKER_GONE", "WORKER_SILENT") and since is not None:
                found.append((since, moment))
                since = None
        return found if since is None else [*found, (since, self.ended)]

    def misses(self, fault: Fault, others: Sequence[Fault], host: str, damaged: Sequence[float] = ()) -> bool:
        """Whether it does not say what befell the machine `host`, though it could know. `others` befell the machine
        too; `damaged` is when its workers damaged what they sent.
        """
        done = fault.done_at
        if done is None or self.ended - done <= NOTICED_SECONDS:
            return False
        there = self.there(host)
        match fault.kind:
            case "killed" | "machine killed" | "cut off":
                # who went already, or was silent for long, does not go once more
                return any(a <= done < b for a, b in there) and not self.has(fault, host, done)
            case "disk full":  # is seen where the worker is asked to keep something, and can answer
                stands = any(each.kind in ("stopped", "paused") for each in others)
                is_asked = any(b - max(a, done) > NOTICED_SECONDS for a, b in there)
                return is_asked and not stands and not self.has(fault, host)
            case "result damaged":  # a film that went with its worker is damaged, and nobody sees it
                is_late = any(each["kind"] == "TASK_LATE" for each in self.events)  # nor one that came second
                is_sent = any(moment >= done for moment in damaged)
                return is_sent and not others and not is_late and not self.has(fault, host)
        return False
