"""A browser on another machine, as far as the page's process can tell: it takes everything and draws nothing."""

from __future__ import annotations

import threading
from types import TracebackType

import msgspec
import viser
from viser._messages import ViewerCameraMessage
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

PATIENCE_S = 60.0


class PlainViewer:
    """Opens the WebSocket of a page and reads it until it is closed.

    Attributes:
        messages: windows of messages received so far; `received_bytes`: their bytes.
    """

    def __init__(self, url: str) -> None:
        self.messages = 0
        self.received_bytes = 0
        self._some = threading.Event()
        self._socket = connect(
            url.replace("http:", "ws:").rstrip("/"),
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            compression=None,
            max_size=None,
            proxy=None,
            open_timeout=PATIENCE_S,
        )
        # With its first camera viser counts a client as one.
        camera = ViewerCameraMessage(
            wxyz=(1.0, 0.0, 0.0, 0.0),
            position=(1.0, 1.0, 1.0),
            fov=1.0,
            near=0.01,
            far=100.0,
            image_height=720,
            image_width=1280,
            look_at=(0.0, 0.0, 0.0),
            up_direction=(0.0, 0.0, 1.0),
        )
        self._socket.send(msgspec.msgpack.encode(camera.as_serializable_dict()))
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def __enter__(self) -> PlainViewer:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()

    def wait_for_page(self) -> None:
        """Wait until the first of it is here."""
        assert self._some.wait(PATIENCE_S), "the page sends nothing"

    def close(self) -> None:
        self._socket.close()
        self._reader.join()

    def _read(self) -> None:
        try:
            for message in self._socket:
                self.messages += 1
                self.received_bytes += len(message)
                self._some.set()
        except ConnectionClosed:
            pass
