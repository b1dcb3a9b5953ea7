"""`Client`: what a browser does on the wire."""

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


class Client:
    """A connection that reads, or, as a browser that hangs, does not.

    Attributes:
      frames: updates of the soil that came.
      gui: label -> id of sliders and buttons.
      texts: HTML that came.
    """

    def __init__(self, port: int, reads: bool = True):
        self._socket = connect(
            f'ws://localhost:{port}', subprotocols=[f'viser-v{viser.__version__}'],
            compression=None, max_size=None, max_queue=16 if reads else 1,
        )  # fmt: skip
        self.frames, self.gui, self.texts = 0, {}, []
        self.send(CAMERA)  # the server counts a client from its first camera on
        if reads:
            threading.Thread(target=self._read, daemon=True).start()

    def send(self, message: dict) -> None:
        """Sends a message of viser's protocol."""
        self._socket.send(msgspec.msgpack.encode(message))

    def slide(self, label: str, value) -> None:
        """Moves a slider, or chooses from a list."""
        update = {'uuid': self.gui[label], 'updates': {'value': value}}
        self.send({'type': 'GuiUpdateMessage', **update})

    def drag(self, position) -> None:
        """Holds the handle at a place; it is not let go."""
        handle = {'name': '/handle'}
        self.send({'type': 'TransformControlsDragStartMessage', **handle})
        place = {'position': tuple(map(float, position)), 'wxyz': (1.0, 0.0, 0.0, 0.0)}
        self.send({'type': 'TransformControlsUpdateMessage', **handle, **place})

    def wait(self, condition, seconds: float = 120.0) -> None:
        """Waits until `condition()` holds; raises TimeoutError where it does not."""
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
                size = int.from_bytes(data[8:16], 'little')
                packet = msgspec.msgpack.decode(zstandard.decompress(data[16 : 16 + size]))
                for message in packet['messages']:
                    changes = message.get('updates', message.get('props', {}))
                    self.frames += message.get('name') == '/soil' and 'points' in changes
                    self.texts += [changes['content']] if 'content' in changes else []
                    if message['type'].startswith('Gui') and 'label' in changes:
                        self.gui[changes['label']] = message['uuid']
        except ConnectionClosed:
            pass
