"""The device that tests of kernels run on: `RAYBATCH_TEST_DEVICE=cuda:0 python -m pytest tests/core`."""

import os

DEVICE = os.environ.get("RAYBATCH_TEST_DEVICE", "cpu")
BLOCK_DIM = 1 if DEVICE == "cpu" else 256
SOURCE_SUFFIX = "cpp" if DEVICE == "cpu" else "cu"  # of the code that Warp generates
