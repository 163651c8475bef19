"""The columns of fixes as checks see them, before and after they were put in order of time."""

from dataclasses import dataclass, replace
from typing import Any

from smoother.session.fix_columns import FixColumns


@dataclass(frozen=True, eq=False)
class FixRows:
    """Columns of fixes of one file.

    has_rows_between : whoever read the file left out rows that its exporter interpolated between fixes.
    """

    columns: FixColumns
    file: str
    has_rows_between: bool = False

    def stream(self, name: str) -> Any:
        """Return the columns, None where no row is left."""
        assert name == "fixes"
        return self.columns if self.columns.t.size else None

    def file_of(self, name: str) -> str:
        """Return the name of the file."""
        assert name == "fixes"
        return self.file

    def with_stream(self, name: str, rows: Any) -> "FixRows":
        """Return the same with other columns."""
        assert name == "fixes"
        return replace(self, columns=rows)
