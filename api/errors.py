"""What can fail, each with its exit code and one sentence; whoever calls the API need know no other place."""

from lightstage.store.errors import DamagedChunkError as DamagedChunkError
from lightstage.store.errors import DamagedGroupError as DamagedGroupError
from lightstage.store.errors import LightstageError as LightstageError
from lightstage.store.errors import RequestError as RequestError
from lightstage.store.errors import WorkError as WorkError
