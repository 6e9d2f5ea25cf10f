"""Names that a robot cannot have: its name begins those of functions, files, a library, a CMake target, a namespace."""

from __future__ import annotations

from symstiff.errors import UserError

_TAKEN = {
    "a word of C or C++": """
        alignas alignof and and_eq asm auto bitand bitor bool break case catch char char16_t char32_t char8_t class
        co_await co_return co_yield compl concept const const_cast consteval constexpr constinit continue decltype
        default delete do double dynamic_cast else enum explicit export extern false float for friend goto if inline
        int linux long mutable namespace new noexcept not not_eq nullptr operator or or_eq private protected public
        register reinterpret_cast requires restrict return short signed sizeof static static_assert static_cast std
        struct switch template this thread_local throw true try typedef typeid typename typeof typeof_unqual union
        unix unsigned using virtual void volatile wchar_t while xor xor_eq""",
    "a header of the C library": """
        alloca assert complex ctype endian errno features fenv float inttypes iso646 limits locale malloc math memory
        newlib reent sched setjmp signal stdalign stdarg stdatomic stdbit stdbool stdckdint stddef stdint stdio stdlib
        stdnoreturn string strings tgmath threads time uchar unistd wchar wctype""",
    "a function of the C library": """
        abort abs acos acosh asin asinh atan atan2 atanh atexit atof atoi atol bsearch calloc cbrt ceil clock cos cosh
        div erf exit exp exp2 expm1 fabs floor fma fmax fmin fmod free frexp gamma getenv hypot index labs ldexp ldiv
        lgamma link log log10 log1p log2 logb longjmp memcpy memset modf nan pow printf puts qsort raise rand read
        realloc remainder remove rename rint round scanf select signal sin sinh sleep sqrt srand strcmp strlen strtod
        system tan tanh tgamma trunc write y0 y1 yn j0 j1 jn""",
    "a system's library": "c crypt dl gcc gomp m pthread rt util",
    "a file or a target of the generated build": "all clean depend edit_cache help install main package test",
}
C_WORDS = frozenset(_TAKEN["a word of C or C++"].split())
_PARTS = (
    "_batch",
    "_params",
    "_rls",
    "_selftest",
)  # endings of another robot's sources, headers and include guards


def free_name(value: str) -> str:
    """The name. Raises UserError where generated code would meet something else of that name."""
    for what, words in _TAKEN.items():
        if value in words.split():
            raise UserError(f"{value!r} is {what}, which the generated code needs: use e.g. {value}_robot")
    if "__" in f"{value}_":
        first = "_".join(word for word in value.split("_") if word)
        raise UserError(
            f"{value!r} gives names with two underscores together, which C++, Structured Text and CasADi do not have: "
            f"use e.g. {first}"
        )
    for part in _PARTS:
        if value.endswith(part):
            first = value.removesuffix(part)
            raise UserError(
                f"{value!r} is what files of a robot {first!r} are called: use e.g. {value}_robot"
            )
    return value
