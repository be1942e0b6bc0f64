"""Skips tests that draw, where there is no OpenGL."""

import pytest


def skip_without_opengl(*, allow_module_level=False):
    """Skips the test, or the module, where moderngl cannot open a context by EGL."""
    try:
        import moderngl

        moderngl.create_standalone_context(require=330, backend="egl").release()
    except Exception as error:  # noqa: BLE001  # the bare class is what moderngl raises
        reason = f"there is no OpenGL by EGL: {error}"
        pytest.skip(reason, allow_module_level=allow_module_level)
