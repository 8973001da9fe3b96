"""Options models filled with values, and the sentences about values that they refuse."""

from collections.abc import Callable, Mapping
from typing import Any

from pydantic import ValidationError

from tactile_loc.core.runtime.errors import ConfigError, did_you_mean, quote


def validate_options(
    model: Any, values: Mapping[str, Any], owner: str, name_option: Callable[[str], str] | None = None
) -> Any:
    """Build the pydantic options `model` from `values`.

    Raises ConfigError if an option is unknown or its value is invalid. The message calls an invalid option
    "key of the owner", or `name_option(key)` if that function is given.
    """
    try:
        return model(**values)
    except ValidationError as error:
        problem = error.errors()[0]
        key = ".".join(map(str, problem["loc"])) or "options"
        if problem["type"] == "extra_forbidden":
            fields = model.model_fields
            for table in problem["loc"][:-1]:  # for an option of a table, list that table's options
                fields = getattr(fields[str(table)].annotation, "model_fields", fields)
            allowed = ", ".join(f"{k} ({_name_type(f.annotation)})" for k, f in fields.items()) or "none"
            near = did_you_mean(str(problem["loc"][-1]), fields)
            raise ConfigError(f"{owner} has no option {key!r}.{near} Known: {allowed}") from error
        if problem["type"] == "missing":
            slot, quoted, _ = owner.removeprefix("the ").partition(" '")  # of a component, such as "the sensor 'file'"
            advice = f"set it with -o {slot}.{key}=..." if quoted else "set it"
            raise ConfigError(f"{owner} needs the option {key!r}; {advice}") from error
        subject = f"{key} of {owner}" if name_option is None else name_option(key)
        raise ConfigError(f"{subject} cannot be {quote(problem['input'])}; {explain_allowed(problem)}") from error


_ALLOWED = {
    "greater_than_equal": "give {ge} or more",
    "greater_than": "give more than {gt}",
    "less_than_equal": "give at most {le}",
    "less_than": "give less than {lt}",
    "literal_error": "give {expected}",
    "finite_number": "give a finite number",
    "string_type": "give a text",
}
_KINDS = {"int": "a whole number", "float": "a number", "bool": "true or false"}


def explain_allowed(problem: Mapping[str, Any]) -> str:
    """Return advice for a refused value, such as "give 1 or more".

    `problem` is an item of `ValidationError.errors()`.
    """
    kind, about = problem["type"], problem.get("ctx", {})
    if kind in _ALLOWED:
        return _ALLOWED[kind].format_map({k: f"{v:g}" if isinstance(v, float) else v for k, v in about.items()})
    if kind == "value_error":
        return str(about["error"]).rstrip(".")
    if (wanted := kind.partition("_")[0]) in _KINDS:
        return f"give {_KINDS[wanted]}"
    return str(problem["msg"]).replace("Input should be", "it must be")


def _name_type(annotation: Any) -> str:
    return annotation.__name__ if isinstance(annotation, type) else str(annotation).replace("typing.", "")
