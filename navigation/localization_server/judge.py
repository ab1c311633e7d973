"""Whether the robot is localized, judged by how well the map explains each scan."""

from __future__ import annotations

import math

from navigation.localization_server.estimate import LocalizationStatus
from navigation.localization_server.section import LocalizerSection
from navigation.pose import Pose

_MEMORY = 0.7  # weight of the previous quality in the next one
_HABIT = 0.95  # weight of the previous usual fit in the next one
_DROP = 0.25  # a scan that fits worse than usual by this much shows a sudden change
_PROVEN = 0.85  # quality from which a new pose needs no further check
_CHECKS = 50  # scans that check a new pose of lower quality while better poses are searched for
_STOOD = (0.01, math.radians(0.5))  # meters and radians; a base that moved less has not moved


REFUTING, REFUTING_SCANS = 0.15, 3
"""The share of beams through walls that counts against a pose; how many such scans in a row refute the pose."""

WIDEST = 0.5  # meters: the largest spread of the particles (standard deviation) of a localized robot


class Judge:
    """Derives the status from the fit of each scan."""

    def __init__(self, settings: LocalizerSection) -> None:
        self._settings = settings
        self.quality = 0.0  # smoothed share of the scan that the map explains, less the share that contradicts it
        self.status, self.reason = LocalizationStatus.NOT_YET, "no initial pose"
        self._begin()

    def _begin(self) -> None:
        self._is_new = True
        self._usual = 0.0
        self._against = self._dropped = 0
        self._checks = _CHECKS
        self._seen: Pose | None = None

    def begin(self) -> None:
        """Start again after an initial pose."""
        self._begin()
        self.status = LocalizationStatus.NOT_YET
        self.reason = "an initial pose was set; waiting for a scan"

    def doubt(self) -> None:
        """Start again because other poses fit better."""
        self._is_new, self._usual = True, 0.0
        self._against = self._dropped = 0
        self._checks = _CHECKS
        self.status, self.reason = (
            LocalizationStatus.ERROR,
            "the scan fits better at another pose; the next scans decide",
        )

    @property
    def doubtful(self) -> bool:
        """Whether the pose is new, and other poses might fit better."""
        return self._checks > 0

    @property
    def was_localized(self) -> bool:
        """Whether the robot has been localized since the last initial pose."""
        return self._seen is not None

    @property
    def refuted(self) -> bool:
        """Whether beams of several scans in a row went through walls, which people cannot cause."""
        return self._against >= REFUTING_SCANS

    @property
    def startled(self) -> bool:
        """Whether the map suddenly explains much less of the scans."""
        return self._dropped >= REFUTING_SCANS

    def add(self, share: float, against: float, wide: float, odometry: Pose, reason: str = "") -> None:
        """Update the status with a scan.

        ``share`` is the share of the scan that the map explains, less the share ``against`` that contradicts the
        pose; ``wide`` is the spread of the particles in meters; ``reason`` explains an empty scan.
        """
        settings = self._settings
        self.quality = share if self._is_new else _MEMORY * self.quality + (1.0 - _MEMORY) * share
        self._is_new = False
        self._against = self._against + 1 if against >= REFUTING else 0
        self._dropped = self._dropped + 1 if share < self._usual - _DROP else 0
        enough = settings.poor if self.status is LocalizationStatus.OK else settings.good
        fits = self.quality >= enough and not self.refuted
        self._checks = 0 if self.quality >= _PROVEN else self._checks - 1 if fits and self._checks else self._checks
        if not fits:
            self.status, self.reason = LocalizationStatus.ERROR, reason or self._lost_reason(odometry, against)
        elif self.doubtful:
            self.status = LocalizationStatus.ERROR if self.was_localized else LocalizationStatus.NOT_YET
            self.reason = f"the map explains {self.quality:.0%} of the scan here; searching for a better pose"
        elif wide > WIDEST:
            self.status = LocalizationStatus.NOT_YET
            self.reason = f"the pose is still uncertain by {wide:.1f} m (standard deviation)"
        else:
            self.status, self.reason = LocalizationStatus.OK, ""
            if self.quality >= settings.good and not self._against:
                self._seen = odometry
            self._usual = share if not self._usual else _HABIT * self._usual + (1.0 - _HABIT) * share

    def _lost_reason(self, odometry: Pose, against: float) -> str:
        lost = f"lost: the map explains {self.quality:.0%} of the scan"
        if against >= REFUTING:
            lost += f", and {against:.0%} of its beams go through walls"
        if self._seen is None:
            return f"{lost}; check the initial pose and the map"
        step = self._seen.inverse @ odometry
        if math.hypot(step.x, step.y) < _STOOD[0] and abs(step.theta) < _STOOD[1]:
            return f"{lost}, but by odometry the base has not moved: the odometry is frozen, or the robot was carried"
        return f"{lost} now"
