"""A light stage's pipeline: normals and reflectance from captures, computed once.

    import lightstage
    session = lightstage.open_store("data").session("subject-a")
    session.run("normals", method="minimal")
    session["normals"]                              # an xarray.Dataset

The folders at the top of the repository are packages below this one; here lie links to them, and what every
process does before anything computes.

    compiled.py     where compiled code is kept
    home.py         what is kept out of the user's home
    sizes.py        sizes as a person reads them
    threads.py      one thread for each library
"""

from typing import TYPE_CHECKING, Any

from lightstage.compiled import keep
from lightstage.home import spare_home
from lightstage.threads import one_each

if TYPE_CHECKING:
    from lightstage.api.sessions import OpenSession as OpenSession
    from lightstage.api.stores import OpenStore as OpenStore
    from lightstage.api.stores import open_store as open_store
    from lightstage.dag.answer import Answer as Answer
    from lightstage.dag.answer import NodeAnswer as NodeAnswer
    from lightstage.store.errors import LightstageError as LightstageError
    from lightstage.store.errors import RequestError as RequestError
    from lightstage.store.errors import WorkError as WorkError

__version__ = "0.1.0"

_API = {
    "open_store": "lightstage.api.stores",
    "OpenStore": "lightstage.api.stores",
    "OpenSession": "lightstage.api.sessions",
    "Answer": "lightstage.dag.answer",
    "NodeAnswer": "lightstage.dag.answer",
    "LightstageError": "lightstage.store.errors",
    "RequestError": "lightstage.store.errors",
    "WorkError": "lightstage.store.errors",
}
"""The names of the Python API, each imported when it is asked for."""
__all__ = sorted(_API)

one_each()
keep()
spare_home()


def __getattr__(name: str) -> Any:
    if name not in _API:
        raise AttributeError(f"module 'lightstage' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(_API[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_API})
