"""A browser's sign-in."""

from __future__ import annotations

from pydantic import Field

from robomend.api.schemas.base import In, Moment, Out, moment_of


class SignInBody(In):
    """A browser signs in."""

    key: str = Field(max_length=100, examples=["rm_…"], description="from `robomend keys create`")


class SessionOut(Out):
    """Who makes the request."""

    name: str = Field(examples=["operator"], description="of the key")
    role: str = Field(examples=["operator"])
    robot: str | None = Field(description="of a robot's key: its own id")
    expires_ns: int | None = Field(description="of a browser that is signed in: when that ends")
    expires: Moment | None = moment_of("expires_ns")
