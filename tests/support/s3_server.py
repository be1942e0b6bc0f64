"""A local S3 server on the loopback."""

from contextlib import contextmanager

from tests.support.store_environment import store_environment


@contextmanager
def s3_server(bucket):
    """Yields the address of a server with a bucket, which the environment names meanwhile."""
    from moto.server import ThreadedMotoServer
    from pyarrow.fs import S3FileSystem

    running = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    running.start()
    host, port = running.get_host_and_port()
    with store_environment(f"http://{host}:{port}"):
        S3FileSystem(
            endpoint_override=f"{host}:{port}", scheme="http", allow_bucket_creation=True
        ).create_dir(bucket)
        yield f"http://{host}:{port}"
    running.stop()
