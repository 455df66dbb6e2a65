"""Public names of `daq`; each is imported at its first use."""

from .acquisition.session import Session as Session
from .catalogue import Catalogue as Catalogue
from .catalogue.query import Query as Query
from .errors import (
    AcquisitionError as AcquisitionError,
    ChannelMissing as ChannelMissing,
    DeviceError as DeviceError,
    LinkLost as LinkLost,
    LogError as LogError,
    OperatorStop as OperatorStop,
    ProcedureError as ProcedureError,
    RecordingError as RecordingError,
)
from .exchange import (
    Recipe as Recipe,
    export_log as export_log,
    import_recording as import_recording,
    make_recipe as make_recipe,
)
from .items import (
    Batch as Batch,
    DeviceEvent as DeviceEvent,
)
from .lockstep import Rehearsal as Rehearsal
from .log import (
    Log as Log,
    open_log as open_log,
)
from .log.recover import recover as recover
from .playback import Playback as Playback
from .recording import (
    open_rig as open_rig,
    record as record,
)
from .replay.checking import ReplayCheck as ReplayCheck
from .replay.decoded_again import (
    DecodedLog as DecodedLog,
    decode_again as decode_again,
)
from .replay.interlocked import (
    InterlockReplay as InterlockReplay,
    replay_interlocks as replay_interlocks,
)
from .signals.run import (
    Run as Run,
    load_run as load_run,
)
