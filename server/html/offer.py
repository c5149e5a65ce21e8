"""Views of affordances: complex resources, properties and actions as values for the templates.

Each form is placed next to its subject: a property's form in its row, an action's form as its button.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import ClassVar, TypeAlias

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import NamedNode

from rosld.ontology.units import symbol_of
from rosld.ontology.vocab import ros
from rosld.server.html.forms import DeleteForm, Form, ValueForm, message_form
from rosld.server.html.labels import NameGroup, capitalize, group_names, label, split_words
from rosld.server.html.page import Csrf, Offer
from rosld.server.html.site import Anchor, Site, readable_path
from rosld.server.html.values import brief_text, iri_view, plain_value, value_view
from rosld.server.html.view import LinkView, TableRow, TableView, TextView, View, escape_controls, time_view
from rosld.server.hypermedia.brief_value import brief_json
from rosld.server.hypermedia.value import Reading, Value
from rosld.server.hypermedia.views import (
    ActionAffordance,
    ActionView,
    ComplexView,
    LinkAffordance,
    Member,
    PropertyAffordance,
    PropertyView,
)
from rosld.shapes.value import MessageShape, OpenShape, ScalarShape, ValueShape

_MOST_ROWS = 4
"""Maximum number of rows of a message that a table of properties shows unfolded."""
_KINDS = {"topics": "topic", "services": "service", "parameters": "parameter"}


class FormTarget(Struct, frozen=True):
    """A form on a page: its target (empty for the page's own URL) and its CSRF token."""

    form: Form
    href: str
    token: str


class PropertyValueView(Struct, frozen=True):
    """The value of a property; without a `view`, `words` are the reason, and `failed` whether that is an error."""

    view: View | None
    unit: Anchor | None = None
    read_at: View | None = None
    message: str = ""
    failed: bool = False
    brief: str = ""
    """A one-line summary of a large message, which the table folds."""


class PropertyRow(Struct, frozen=True):
    """A property of a complex resource; `change` links to its own page if it can only be set there."""

    anchor: Anchor
    relation: Anchor | None
    value: PropertyValueView
    form: FormTarget | None = None
    edit_link: Anchor | None = None


class ActionRow(Struct, frozen=True):
    """An action of a complex resource, without a form where it cannot be invoked."""

    anchor: Anchor
    relation: Anchor | None
    form: FormTarget | None = None


class LinkRow(Struct, frozen=True):
    """A link of a complex resource: its relation in words and its target."""

    label: str
    anchor: Anchor
    relation: Anchor | None


class ComplexOffer(Struct, frozen=True):
    """A complex resource. `children` are the nested complex resources without a link.

    Many properties or actions are in groups, which a page folds.
    """

    kind: ClassVar[str] = "complex"
    properties: tuple[PropertyRow, ...]
    actions: tuple[ActionRow, ...]
    links: tuple[LinkRow, ...]
    children: tuple[Anchor, ...]
    part_of: Anchor | None
    mapping: Anchor | None

    @property
    def property_groups(self) -> tuple[NameGroup[PropertyRow], ...]:
        """The properties in groups; empty if they are few."""
        return group_names(self.properties, lambda row: row.anchor.text)

    @property
    def action_groups(self) -> tuple[NameGroup[ActionRow], ...]:
        """The actions in groups; empty if they are few."""
        return group_names(self.actions, lambda row: row.anchor.text)

    @property
    def is_folded(self) -> bool:
        """Whether there are groups."""
        return bool(self.property_groups or self.action_groups)

    @property
    def has_settable(self) -> bool:
        """Whether a property can be set from this page."""
        return any(row.form or row.edit_link for row in self.properties)


class PropertyOffer(Struct, frozen=True):
    """A single property; `facts` are its type and quantity kind, `sources` the topics and parameters behind it.

    `part_of` links to its complex resource.
    """

    kind: ClassVar[str] = "property"
    value: PropertyValueView
    facts: tuple[View, ...]
    sources: TableView
    part_of: Anchor | None
    relation: Anchor | None


class ActionOffer(Struct, frozen=True):
    """A single action; `sources` is what it invokes."""

    kind: ClassVar[str] = "action"
    is_callable: bool
    sources: TableView
    part_of: Anchor | None
    relation: Anchor | None


OfferView: TypeAlias = ComplexOffer | PropertyOffer | ActionOffer


def form_targets(forms: Iterable[Form], allow: Iterable[str], csrf: Csrf, site: Site) -> tuple[FormTarget, ...]:
    """Return the forms of a page with their tokens.

    Forms to the page's own URL need a method in `allow`; forms to other URLs are omitted if this server is read-only.
    """
    allowed = frozenset(allow)
    return tuple(_form_targets(forms, allowed, csrf, site))


def _form_targets(forms: Iterable[Form], allowed: frozenset[str], csrf: Csrf, site: Site) -> Iterator[FormTarget]:
    for form in forms:
        if not form.action:
            if form.method in allowed:
                yield FormTarget(form, "", csrf(""))
            continue
        href = site.href(form.action) if site.page_url(form.action) else None
        if href is not None and not site.read_only and site.may(form.method, form.action):
            yield FormTarget(form, href, csrf(form.action))


def offer_view(offer: Offer, site: Site, posted: Iterable[FormTarget]) -> OfferView:
    """Return the view of an offer; forms that post to other URLs are placed next to their subjects."""
    match offer:
        case ComplexView():
            return _complex(offer, site, {each.form.action: each for each in posted if each.form.action})
        case PropertyView(affordance, reading):
            return PropertyOffer(
                value_of(affordance, reading, None, site),
                tuple(_facts(affordance.shape, site)),
                _behind(site, (ros.readsFrom, offer.reads_from), (ros.writesTo, offer.writes_to)),
                site.anchor(offer.part_of),
                _term(affordance.predicate, site),
            )
        case ActionView(affordance):
            return ActionOffer(
                affordance.request is not None,
                _behind(site, (ros.invokes, () if offer.invokes is None else (offer.invokes,))),
                site.anchor(offer.part_of),
                _term(affordance.relation, site),
            )


def _complex(view: ComplexView, site: Site, posted: Mapping[str, FormTarget]) -> ComplexOffer:
    linked = {link.target for link in view.links}
    return ComplexOffer(
        tuple(_property_row(member, site, posted) for member in view.members),
        tuple(_action_row(action, site, posted) for action in view.actions),
        tuple(_link_rows(view.links, site)),
        tuple(
            _named_link(child, readable_path(child.removeprefix(view.url)), site)
            for child in view.children
            if child not in linked
        ),
        site.anchor(view.parent) if view.parent else None,
        site.anchor(view.mapping) if view.mapping else None,
    )


def _named_link(url: str, name: str, site: Site) -> Anchor:
    found = site.anchor(url) or Anchor("", "", url)
    return Anchor(found.href, escape_controls(name), url, found.external)


def _term(term: NamedNode | None, site: Site) -> Anchor | None:
    return site.anchor(term.value) if term is not None else None


def _property_row(member: Member, site: Site, posted: Mapping[str, FormTarget]) -> PropertyRow:
    one = member.affordance
    anchor = _named_link(one.url, one.title or one.name, site)
    own = posted.get(one.url) if member.field is None else None
    change = anchor if one.write and own is None else None
    return PropertyRow(
        anchor, _term(one.predicate, site), value_of(one, member.reading, member.field, site), own, change
    )


def _action_row(action: ActionAffordance, site: Site, posted: Mapping[str, FormTarget]) -> ActionRow:
    anchor = _named_link(action.url, site.short_name(action.url), site)
    return ActionRow(anchor, _term(action.relation, site), posted.get(action.url))


def _link_rows(links: Iterable[LinkAffordance], site: Site) -> Iterator[LinkRow]:
    for link in links:
        anchor = site.anchor(link.target)
        if anchor is not None:
            yield LinkRow(escape_controls(label(link.relation.value)), anchor, _term(link.relation, site))


def value_of(affordance: PropertyAffordance, reading: Reading, field: str | None, site: Site) -> PropertyValueView:
    """Return the value of a property, or of one of its fields, with its unit and the time when it was read."""
    read = time_view(reading.read_ns) if reading.read_ns is not None else None
    if reading.value is not None:
        view = value_view(reading.value, site, field)
        return PropertyValueView(view, _unit(affordance, site), read, brief=_brief(reading.value, view))
    if reading.failure is not None:
        return PropertyValueView(None, read_at=read, message=escape_controls(reading.failure), failed=True)
    return PropertyValueView(None, read_at=read, message="no value yet" if affordance.read else "can only be written")


def _brief(value: Value, view: View) -> str:
    """Return a one-line summary of a message with many or nested fields; empty for other values."""
    if not isinstance(view, TableView) or not (len(view.rows) > _MOST_ROWS or any(row.nested for row in view.rows)):
        return ""
    try:
        return brief_text(brief_json(value)) or "its fields"
    except ValueError:
        return "its fields"


def _unit(affordance: PropertyAffordance, site: Site) -> Anchor | None:
    unit = None if isinstance(affordance.shape, MessageShape) else affordance.shape.quantity.unit
    symbol = escape_controls(symbol_of(unit)) if unit is not None else ""
    if unit is None or not symbol:
        return None
    return Anchor(site.href(unit) or "", symbol, unit, external=True)


def _facts(shape: ValueShape, site: Site) -> Iterator[View]:
    """Yield the type of a value and its quantity kind."""
    match shape:
        case MessageShape(schema):
            yield iri_view(f"{site.types}{schema.ref.name}", site)
            return
        case ScalarShape(kind):
            yield TextView(kind.name)
        case OpenShape():
            pass
    if shape.quantity.kind is not None:
        yield iri_view(shape.quantity.kind, site)


def _behind(site: Site, *relations: tuple[NamedNode, Iterable[str]]) -> TableView:
    """Return the underlying topics, services and parameters by their relation."""
    rows = []
    for relation, urls in relations:
        views = tuple(_source(url, site) for url in urls)
        if views:
            term = site.anchor(relation.value)
            rows.append(
                TableRow(
                    label(relation.value), views, about=escape_controls(site.prefixed_name(relation.value)), term=term
                )
            )
    return TableView(tuple(rows))


def _source(url: str, site: Site) -> View:
    anchor = site.anchor(url)
    kind = url.removeprefix(site.base).partition("/")[0]
    return LinkView(anchor, _KINDS.get(kind, "")) if anchor is not None else TextView(escape_controls(url), tone="iri")


MAX_FORMS = 100
"""Maximum number of properties that can be set on the page of their complex resource."""


def forms_of(view: Offer) -> tuple[Form, ...]:
    """Return the forms on the page of a view, with an `action` if they post to another URL.

    The page of a complex resource has a form for each action and for each property that is a single scalar.
    """
    match view:
        case PropertyView(affordance, reading):
            return (property_form(affordance, reading),) if affordance.write else ()
        case ActionView(affordance):
            invoke = _once(action_form(affordance)) if affordance.is_open else ()
            return (*invoke, *cancel_forms(affordance))
        case ComplexView():
            actions = (form for one in view.actions for form in _once(action_form(one), one.url))
            return (*_member_forms(view), *actions)


def property_form(affordance: PropertyAffordance, reading: Reading) -> ValueForm:
    """Return the form for the value of a property."""
    return ValueForm(
        affordance.shape,
        value=plain_value(reading.value),
        about=escape_controls(affordance.description or ""),
        label=affordance.title or affordance.name,
    )


def _member_forms(view: ComplexView) -> Iterator[ValueForm]:
    settable = [member for member in view.members if is_scalar_member(member)]
    for member in settable[:MAX_FORMS]:
        yield replace(property_form(member.affordance, member.reading), action=member.affordance.url)


def is_scalar_member(member: Member) -> bool:
    """Whether one input can set a member: a scalar that is the whole of its property."""
    return member.affordance.write and member.field is None and isinstance(member.affordance.shape, ScalarShape)


def action_form(affordance: ActionAffordance) -> ValueForm | None:
    """Return the form that invokes an action (only a button without a request), or None if it cannot be invoked."""
    if affordance.request is None:
        return None
    button = affordance.title or capitalize(split_words(affordance.name))
    return message_form(affordance.request, "POST", affordance.title or affordance.name, button)


def cancel_forms(affordance: ActionAffordance) -> tuple[DeleteForm, ...]:
    """Return the button that cancels the goals of an action, if they can be canceled."""
    if affordance.goals is None or not affordance.goals.can_cancel:
        return ()
    return (DeleteForm("Cancel", "Cancel the goal", "Cancels every active goal that was sent through rosld."),)


def _once(form: ValueForm | None, action: str = "") -> tuple[ValueForm, ...]:
    return () if form is None else (replace(form, action=action),)
