"""The run-time type checks of the tests: beartype under jaxtyping's hook, with int accepted where float is asked."""

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
