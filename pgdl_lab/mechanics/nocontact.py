"""Contact that never acts, for bodies without a skin to watch."""

from pgdl_lab.mechanics.contact import Contact


class NoContact(Contact):
    """Contact that never acts, and needs no skin."""

    def __init__(self) -> None:
        self.mode, self.active = "off", False
