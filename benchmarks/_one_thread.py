"""One thread of linear algebra in each process of a benchmark, unless the environment says otherwise.

To be imported before numpy is. Matrices are small here: threads of several processes on as many cores wait for one
another, and a diagnosis takes twice as long.
"""

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
