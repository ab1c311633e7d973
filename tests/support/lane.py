"""Whether the test daemons use the local transport (lane): ``MIDSPAN_TEST_LANE=off`` runs any suite without it."""

from __future__ import annotations

import os

LANE = os.environ.get("MIDSPAN_TEST_LANE") != "off"
