"""POST /batches, for programs and for the page: a body → logs in a folder → a batch that waits."""

from __future__ import annotations

from typing import Any

from starlette.requests import Request

from robomend.api.batch_body import FORM, read_form, read_json, typed, validated
from robomend.api.body import check_content_type, content_type
from robomend.api.deps import Parts
from robomend.api.schemas.batch import BatchBody, BatchFields
from robomend.batches.batches import NewBatch
from robomend.errors import InputError
from robomend.security import Principal
from robomend.store.records import Json

PATHS = "paths"
"""A field of the page's form: names below batch_folder, one a line, where no file is chosen."""


async def create(request: Request, parts: Parts, principal: Principal, *, page: bool = False) -> Json:
    """Keep a batch, and return it.

    Args:
        request: with a JSON body or a form.
        parts: of the service.
        principal: who asks.
        page: whether the form may name logs of this computer in PATHS.
    """
    parts.batches.check_installed()
    request.scope["robomend.waits"] = True
    check_content_type(request, FORM, *(() if page else ("application/json",)))
    if content_type(request) != FORM:
        body = await read_json(request, parts.settings, parts.robots.readers)
        async with parts.batches.new() as new:
            return await _keep_named(parts, new, body, principal)
    async with parts.batches.new() as new:
        form = await read_form(request, parts.settings, new.folder.logs)
        paths = form.texts.pop(PATHS, "").split("\n") if page else []
        logs = [line.strip() for line in paths if line.strip()]
        if logs and form.names:
            raise InputError("give either files or paths, not both")
        if logs:
            return await _keep_named(
                parts, new, validated(BatchBody, {**typed(form.texts), "logs": logs}), principal
            )
        if not form.names:
            raise InputError("logs: the form has no file")
        fields = validated(BatchFields, typed(form.texts))
        return await _keep(parts, new, fields, principal, names=sorted(form.names), size=form.size)


async def _keep_named(parts: Parts, new: NewBatch, body: BatchBody, principal: Principal) -> Json:
    folder, names = await parts.batches.below_folder(body.logs)
    return await _keep(parts, new, body, principal, names=names, folder=folder, size=0)


async def _keep(
    parts: Parts, new: NewBatch, fields: BatchFields, principal: Principal, *, folder: Any = None, **logs: Any
) -> Json:
    subject = await parts.robots.models.subject(fields.model, fields.source)
    name = subject.version if fields.model is not None else f"{subject.system.name} (as sent)"
    return await parts.batches.keep(
        new,
        model=name,
        source=subject.system.source,
        observers=fields.observers,
        folder=folder,
        options=fields.options(),
        by=principal.name,
        reason=fields.reason,
        **logs,
    )
