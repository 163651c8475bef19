"""The corpus, the mutators and the campaign are scripts too; this is where the tests find them."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
