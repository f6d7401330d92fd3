"""One session of a store: run its nodes, look at how they stand, take results out."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.answers import Answer, Why, answer, status, why
from lightstage.api.requests import Frames, Request, make_request
from lightstage.dag.watcher import Watcher
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    import xarray

    from lightstage.dag.explain import NodeStatus
    from lightstage.store.sessions import Progress, Session


class OpenSession:
    """A session; made by `OpenStore.session`.

    >>> session = lightstage.open_store("data").session("subject-a")
    >>> session.run("normals", method="minimal")
    >>> session["normals"].normal.dims
    ('tracking', 'band', 'xyz', 'y', 'x')
    """

    def __init__(self, opened: Store, name: str) -> None:
        self.opened = opened
        """The store's folder; not for users."""
        self.name = name

    def __repr__(self) -> str:
        session = self.read()
        sizes = ", ".join(f"{dim} {size}" for dim, size in session.sizes.items())
        return f"<OpenSession '{self.name}' of {self.opened.root}: {sizes}>"

    @property
    def folder(self) -> Path:
        """Where the store keeps it."""
        return self.opened.sessions / self.name

    def read(self) -> "Session":
        """The session as the store holds it now."""
        from lightstage.store.sessions import read_session

        return read_session(self.name, self.opened)

    @property
    def facts(self) -> Mapping[str, Any]:
        """What the capture says of itself: cameras, bands_nm, illumination, frame_rate_hz, ..."""
        return self.read().facts

    @property
    def items(self) -> Mapping[str, str]:
        """The calibration items that it uses: kind to name."""
        return {kind: f"{kind}-{digest[:12]}" for kind, digest in self.read().items.items()}

    def run(
        self,
        *nodes: str,
        frames: Frames = None,
        pipeline: str | Path | None = None,
        items: Mapping[str, str | Path] | None = None,
        set: Mapping[str, Any] | None = None,
        workers: int | None = None,
        scheduler: str | None = None,
        progress: Watcher | None = None,
        **params: Any,
    ) -> Answer:
        """Compute nodes, and all that they need; what is known already is not computed again.

        >>> session.run("normals", method="minimal")
        >>> session.run(set={"normals.method": "ratio", "align.engine": "none"}, frames=(0, 10))

        Args:
            nodes: which; none: all that the pipeline computes unasked.
            frames: A:B, half-open; what depends on others is left out.
            pipeline: a pipeline file instead of the current folder's, or the packaged one.
            items: calibration items for this run alone, kind to file.
            set: parameters, `node.param` to value.
            workers: compute on so many processes instead of threads.
            scheduler: compute on the Dask cluster at this address, which shares the store.
            progress: is told how it goes on.
            params: parameters of the one node that is named.

        Raises:
            RequestError: the request is wrong: a sentence that says what would be right.
            WorkError: the request is right, and the work failed.
        """
        request = self._request(nodes, frames, pipeline, items, set, params)
        return answer(request, self.opened, workers=workers, scheduler=scheduler, progress=progress)

    def status(
        self,
        *nodes: str,
        frames: Frames = None,
        pipeline: str | Path | None = None,
        items: Mapping[str, str | Path] | None = None,
        set: Mapping[str, Any] | None = None,
        **params: Any,
    ) -> "Mapping[str, NodeStatus]":
        """How each node stands: fresh, stale, partial or missing; of a run with the same arguments.

        >>> session.status()["normals"].condition
        'fresh'
        """
        return status(self._request(nodes, frames, pipeline, items, set, params), self.opened)

    def why(
        self,
        node: str,
        *,
        frames: Frames = None,
        pipeline: str | Path | None = None,
        items: Mapping[str, str | Path] | None = None,
        set: Mapping[str, Any] | None = None,
        **params: Any,
    ) -> Why:
        """Why a node would be computed again, or, where it is fresh, why it last was.

        >>> print(session.why("normals", method="ratio"))
        """
        return why(self._request((node,), frames, pipeline, items, set, params), self.opened)

    def path(self, node: str, *, pipeline: str | Path | None = None) -> Path:
        """Where a node's result lies, a zarr group; of a node that brings in the session, its pictures.

        >>> xarray.open_zarr(session.path("normals"))

        Raises:
            RequestError: it has no result yet.
        """
        from lightstage.api.groups import group_of

        return group_of(self.name, node, self.opened, pipeline)

    def __getitem__(self, node: str) -> "xarray.Dataset":
        """A node's result; every byte is checked when it is read.

        >>> session["normals"].albedo.sel(tracking=0)

        Raises:
            RequestError: it has no result yet.
        """
        from lightstage.api.groups import open_group, refuse_stranger

        session = self.read()
        refuse_stranger(session, node, self.opened)
        return open_group(session, node, self.opened)

    def open(self, node: str, *, pipeline: str | Path | None = None) -> "xarray.Dataset":
        """The same as `session[node]`, for nodes of another pipeline file."""
        from lightstage.api.groups import open_group

        return open_group(self.read(), node, self.opened, pipeline)

    @property
    def results(self) -> list[str]:
        """The nodes that have a result."""
        from lightstage.api.groups import results_of

        return results_of(self.name, self.opened)

    def __iter__(self) -> Iterator[str]:
        return iter(self.results)

    def __contains__(self, node: str) -> bool:
        return node in self.results

    def _ipython_key_completions_(self) -> list[str]:
        return self.results

    def bind(self, item: str | Path) -> str:
        """Let the session use a calibration item from now on: a file, or the name of one in the store.

        >>> session.bind("homography.yaml")
        'homography-3f2a...'

        Returns:
            the item's name.

        Raises:
            RequestError: it is no item, or does not fit.
        """
        from lightstage.api.items import bind

        return bind(self.read(), item, self.opened).item

    def export(
        self,
        node: str,
        folder: str | Path,
        *,
        format: str,
        convention: str = "opengl",
        pipeline: str | Path | None = None,
        progress: "Progress | None" = None,
    ) -> list[Path]:
        """Write every picture of a node's result into a folder, for tools that do not read zarr.

        >>> session.export("normals", "out", format="exr")

        Args:
            format: png8, png16, exr or npy.
            convention: where green points in maps of normals: opengl (up) or directx (down).
            progress: passes items on and shows how far it is.

        Returns:
            the files.

        Raises:
            RequestError: the node has no result, the format is not known, or something else is in the files' place.
        """
        from lightstage.api.exports import export_planes
        from lightstage.products.progress import silent

        return export_planes(
            self.open(node, pipeline=pipeline),
            node,
            self.name,
            Path(folder),
            form=format,
            convention=convention,
            progress=progress or silent,
        )

    def _request(
        self,
        nodes: tuple[str, ...],
        frames: Frames,
        pipeline: str | Path | None,
        items: Mapping[str, str | Path] | None,
        changes: Mapping[str, Any] | None,
        params: Mapping[str, Any],
    ) -> Request:
        if params and len(nodes) != 1:
            raise RequestError(
                f"{', '.join(params)}: parameters without a node's name are those of the one node that is named, "
                f"and {len(nodes)} are; say set={{'node.{next(iter(params))}': ...}}"
            )
        own = {f"{nodes[0]}.{name}": value for name, value in params.items()}
        return make_request(
            self.name,
            nodes,
            changes={**(changes or {}), **own},
            frames=frames,
            pipeline=pipeline,
            items=items or {},
        )
