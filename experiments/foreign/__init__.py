"""Tables as instruments and controllers write them, made into the tables of a campaign by a small mapping file."""

from experiments.foreign.mapping import FORMAT, Mapping, TableMapping, read_mapping
from experiments.foreign.tables import Imported, import_tables

__all__ = ["FORMAT", "Imported", "Mapping", "TableMapping", "import_tables", "read_mapping"]
