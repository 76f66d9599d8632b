"""Structs of msgspec with abstract methods."""

from abc import ABCMeta

from msgspec import StructMeta


class AbstractStruct(StructMeta, ABCMeta):
    """The metaclass of a struct whose subclasses have to define what it declares with `abc.abstractmethod`."""
