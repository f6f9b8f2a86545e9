"""What fits are told in tests that are about something else: to look for it takes most of their time."""

from __future__ import annotations

from typing import Any

HELD: dict[str, Any] = {"intersample": "zoh", "delay": 0.0}  # how inputs arrive
KNOWN: dict[str, Any] = {**HELD, "noise": "white"}
