"""`Client`: what a browser does on the wire, for the benchmark and the tests."""

import threading
import time

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

CAMERA = {
    'type': 'ViewerCameraMessage', 'wxyz': (1.0, 0.0, 0.0, 0.0), 'position': (0.0, 0.0, 1.0),
    'fov': 1.0, 'near': 0.01, 'far': 100.0, 'image_height': 480, 'image_width': 640,
    'look_at': (0.0, 0.0, 0.0), 'up_direction': (0.0, 1.0, 0.0),
}  # fmt: skip


def decoded(data: bytes) -> list[dict]:
    """The messages of a packet from the server; arrays are left as references."""
    size = int.from_bytes(data[8:16], 'little')
    return msgspec.msgpack.decode(zstandard.decompress(data[16 : 16 + size]))['messages']


class Client:
    """A connection that reads, or one that is too slow to.

    Args:
      port: of the page.
      reads: whether packets are read; if not, they pile up as with a browser that hangs.

    Attributes:
      frames: updates of the soil that came.
      received: bytes that came.
      gui: label -> id of sliders and buttons.
    """

    def __init__(self, port: int, reads: bool = True):
        self._socket = connect(
            f'ws://localhost:{port}', subprotocols=[f'viser-v{viser.__version__}'],  # type: ignore[list-item]
            compression=None, max_size=None, max_queue=16 if reads else 1,
        )  # fmt: skip
        self.frames, self.received, self.gui = 0, 0, {}
        self.send(CAMERA)  # the server counts a client from its first camera on
        if reads:
            threading.Thread(target=self._read, daemon=True).start()

    def send(self, message: dict) -> None:
        """Sends a message of viser's protocol."""
        self._socket.send(msgspec.msgpack.encode(message))

    def slide(self, label: str, value: float) -> None:
        """Moves a slider; raises KeyError where there is none of that label."""
        update = {'uuid': self.gui[label], 'updates': {'value': value}}
        self.send({'type': 'GuiUpdateMessage', **update})

    def drag(self, position, wxyz=(1.0, 0.0, 0.0, 0.0)) -> None:
        """Holds the handle at a place; it is not let go."""
        self.send({'type': 'TransformControlsDragStartMessage', 'name': '/handle'})
        self.send(
            {
                'type': 'TransformControlsUpdateMessage', 'name': '/handle',
                'position': tuple(map(float, position)), 'wxyz': tuple(map(float, wxyz)),
            }
        )  # fmt: skip

    def wait(self, condition, seconds: float = 60.0) -> None:
        """Waits until `condition()` holds.

        Raises:
          TimeoutError: it did not.
        """
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError('the page did not get there')
            time.sleep(0.02)

    def close(self) -> None:
        """Ends the connection, as a tab that is closed."""
        self._socket.close()

    def _read(self):
        try:
            for data in self._socket:
                self.received += len(data)
                for message in decoded(data):
                    if message.get('name') == '/soil' and 'points' in message.get('updates', {}):
                        self.frames += 1
                    elif message['type'].startswith('Gui') and 'label' in message.get('props', {}):
                        self.gui[message['props']['label']] = message['uuid']
        except ConnectionClosed:
            pass
