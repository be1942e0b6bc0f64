"""A local S3 server on the loopback that serves a folder, and may lie about it."""

from __future__ import annotations

import html
import threading
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

from tests.support.store_environment import store_environment

BUCKET = "lake"
_DATE = "Tue, 14 Nov 2023 00:00:00 GMT"


@dataclass
class LyingStore:
    """What a store says.

    Attributes:
        folder: its objects.
        listed: further objects that it lists, with their sizes.
        statuses: the errors with which it answers for objects, by the ends of their names.
        cut: the ends of the names of objects of which it sends only a half.
        requests: the requests so far: the method and the path.
    """

    folder: Path
    listed: Mapping[str, int] = field(default_factory=dict)
    statuses: Mapping[str, int] = field(default_factory=dict)
    cut: tuple[str, ...] = ()
    requests: list[tuple[str, str]] = field(default_factory=list)

    def objects(self):
        """Returns the sizes of what it lists, by name."""
        files = {
            file.relative_to(self.folder).as_posix(): file.stat().st_size
            for file in self.folder.rglob("*")
            if file.is_file()
        }
        return {**files, **self.listed}


@contextmanager
def lying_store(folder):
    """Yields a store whose bucket has the files of a folder; the environment names it meanwhile."""
    store = LyingStore(folder)
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Handler", (_Handler,), {"store": store}))
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    address = f"http://127.0.0.1:{server.server_port}"
    try:
        with store_environment(address, AWS_MAX_ATTEMPTS="1"):
            yield store
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # else each answer waits 40 ms for its head to be acknowledged
    store: LyingStore

    def log_message(self, *_):
        """Says nothing."""

    def do_GET(self):
        """Answers with an object, or a listing."""
        url = urlsplit(self.path)
        path = unquote(url.path).lstrip("/")
        self.store.requests.append((self.command, path))
        bucket, _, key = path.partition("/")
        if bucket != BUCKET:
            self._send(404, b"")
        elif not key:
            query = parse_qs(url.query, keep_blank_values=True)
            self._send(200, self._listing(query.get("prefix", [""])[0], "delimiter" in query))
        else:
            self._object(key)

    do_HEAD = do_GET  # noqa: N815

    def _object(self, key):
        statuses = self.store.statuses.items()
        status = next((status for end, status in statuses if key.endswith(end)), None)
        file = self.store.folder / key
        if status is not None:
            self._send(status, b"")
        elif not file.is_file():
            self._send(404, b"<Error><Code>NoSuchKey</Code></Error>")
        else:
            content = file.read_bytes()
            size = len(content)
            asked = self.headers.get("Range")
            if asked is not None:
                first, _, last = asked.removeprefix("bytes=").partition("-")
                content = content[int(first) : int(last) + 1]
                size = len(content)
            if key.endswith(self.store.cut):
                content = content[: len(content) // 2]
                self.close_connection = True
            self._send(200 if asked is None else 206, content, size)

    def _send(self, status, content, size=None):
        self.send_response(status)
        self.send_header("Content-Length", str(len(content) if size is None else size))
        self.send_header("Last-Modified", _DATE)
        self.send_header("ETag", '"x"')
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content)

    def _listing(self, prefix, has_folders):
        files, folders = [], set[str]()
        for key, size in sorted(self.store.objects().items()):
            rest = key.removeprefix(prefix)
            if not key.startswith(prefix):
                continue
            if has_folders and "/" in rest:
                folders.add(f"{prefix}{rest.partition('/')[0]}/")
            else:
                files.append(
                    f"<Contents><Key>{html.escape(key)}</Key><Size>{size}</Size>"
                    "<LastModified>2023-11-14T00:00:00.000Z</LastModified></Contents>"
                )
        files += [
            f"<CommonPrefixes><Prefix>{html.escape(one)}</Prefix></CommonPrefixes>"
            for one in sorted(folders)
        ]
        return (
            '<ListBucketResult xmlns="http://s3.amazonaws.com/doc/2006-03-01/">'
            f"<Name>{BUCKET}</Name><KeyCount>{len(files)}</KeyCount><Prefix>{html.escape(prefix)}</Prefix>"
            f"<IsTruncated>false</IsTruncated>{''.join(files)}</ListBucketResult>"
        ).encode()
