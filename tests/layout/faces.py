"""A contract of import-linter: packages import names of other packages, never modules inside them."""

from typing import Any

from importlinter import Contract, ContractCheck, fields, output


class Faces(Contract):  # type: ignore[misc]
    """Every import from another package of the root names the package itself, or a module listed as public."""

    public = fields.SetField(subfield=fields.StringField(), required=False, default=set())

    def check(self, graph: Any, verbose: bool) -> ContractCheck:
        """Find every direct import of a module inside another package."""
        public: set[str] = self.public  # type: ignore[assignment]
        inside = [
            (importer, imported)
            for importer in graph.modules
            if importer.startswith("lmeasure.")
            for imported in graph.find_modules_directly_imported_by(importer)
            if imported.startswith("lmeasure.") and imported.count(".") > 1 and imported not in public
            if importer.split(".")[1] != imported.split(".")[1]
        ]
        return ContractCheck(kept=not inside, metadata={"inside": sorted(inside)})

    def render_broken_contract(self, check: ContractCheck) -> None:
        """Print each import, a line each."""
        for importer, imported in check.metadata["inside"]:
            output.print_error(f"- {importer} imports {imported}", bold=False)
        output.new_line()
