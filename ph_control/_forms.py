"""The canonical forms as methods of a port-Hamiltonian system.

They are made of systems, and are in a module above: this is the one place where a method reaches up, when it is called.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


class HasForms:
    """A system with a controllable and an observable form."""

    def controllable_form(self, **names: Any) -> Any:
        """Controllable Hamiltonian canonical form with the same parameters: what `ch` makes of this system.

        Parameters
        ----------
        **names
            `name`, `inputs`, `outputs`, `states` as for `control.ss`; signal names are kept.

        Returns
        -------
        ControllableHamiltonian
            Of the size of this system; isomorphic to it iff it is canonical.

        Raises
        ------
        StructureError
            If the system has several ports.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.frenkel_kontorova(2).controllable_form().a.round(12)
        array([1., 0., 3., 0.])
        """
        return _canonical_forms().ch(self, **names)

    def observable_form(self, **names: Any) -> Any:
        """Observable Hamiltonian canonical form with the same parameters: what `oh` makes of this system.

        Parameters
        ----------
        **names
            As for `controllable_form`.

        Returns
        -------
        ObservableHamiltonian
            Of the size of this system; isomorphic to it iff it is canonical.

        Raises
        ------
        StructureError
            If the system has several ports.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.frenkel_kontorova(2).observable_form().B.T.round(12)
        array([[0., 1., 0., 1.]])
        """
        return _canonical_forms().oh(self, **names)


def _canonical_forms() -> Any:
    return import_module(".canonical_forms", __package__)
