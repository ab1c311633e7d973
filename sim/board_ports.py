"""The ports of the wheels' control board (`controlBoard_nws_yarp`), for clients of YARP 3 and 4."""

from __future__ import annotations

from bridge.modules.host import Host
from sim.board import WheelBoard
from sim.simulation import Simulation
from yarp_compat.dev.controlboard.server import BoardAnswers, positions


class BoardPorts:
    """The ports; ``name`` is what theirs begin with."""

    def __init__(self, host: Host, name: str, simulation: Simulation) -> None:
        # what nobody waits for any more never moves a wheel
        board = WheelBoard(lambda: simulation.board, lambda action: host.loop.call(action, late=False))
        answers = BoardAnswers(board)
        self._board = board
        yarp = host.yarp
        yarp.serve(f"{name}/nws/rpc:i", answers.service)
        yarp.respond(f"{name}/rpc:i", answers.respond)
        yarp.input(f"{name}/command:i", answers.take)
        host.answer("halt", lambda _params: host.loop.call(lambda: self._halt(simulation)))
        self._state, self._positions = yarp.output(f"{name}/stateExt:o"), yarp.output(f"{name}/state:o")

    @staticmethod
    def _halt(simulation: Simulation) -> dict[str, bool]:
        """Forget what was commanded; later commands are obeyed again."""
        simulation.board.halt()
        simulation.drive.halt()
        return {"halted": True}

    def tell(self, envelope: str) -> None:
        """Say what the wheels do, on the simulation's thread."""
        if self._state.heard or self._positions.heard:
            state = self._board.state()
            self._state.write(state, envelope)
            self._positions.write(positions(state), envelope)
