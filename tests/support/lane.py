"""Whether the daemons of the suites have the lane: ``MIDSPAN_TEST_LANE=off`` runs any suite without it."""

from __future__ import annotations

import os

LANE = os.environ.get("MIDSPAN_TEST_LANE") != "off"
