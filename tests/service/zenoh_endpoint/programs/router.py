"""A router. Arguments: where to listen, and a config file where there is one."""

import sys
import threading
from pathlib import Path

from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.session import open_session

listen, *file = sys.argv[1:]
config_file = Path(file[0]) if file else None
session = open_session(ZenohSettings(mode="router", listen=(listen,), config_file=config_file))
sys.stdout.write("up\n")
sys.stdout.flush()
threading.Event().wait()
