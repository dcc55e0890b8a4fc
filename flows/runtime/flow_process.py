"""The program of a flow run's process: Prefect's engine, which here reads no results but records of hfb's.

A run's state at the server may name a file as its result, and how it is deserialised; members set states.
"""

import runpy

from hfb.tasks.core.result_records import read_own_records_alone

if __name__ == "__main__":
    read_own_records_alone()
    runpy.run_module("prefect.engine", run_name="__main__")
