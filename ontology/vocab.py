"""The terms rosld writes and reads, one class a namespace: `ros.publishes` is the NamedNode `ros:publishes`.

The ROS vocabulary itself is defined in `rosld.ttl` beside this file; a test holds the two against each other,
both ways. A trailing underscore only keeps a term clear of a Python keyword: `sh.or_` is `sh:or`.
"""

# The attributes are spelt as the vocabularies spell them.
# ruff: noqa: N801, N815

from __future__ import annotations

from collections.abc import Mapping

from pyoxigraph import NamedNode


class Namespace:
    """A namespace IRI and its terms: every annotated attribute becomes the NamedNode of that name."""

    iri: str

    def __init_subclass__(cls, *, iri: str) -> None:
        cls.iri = iri
        for name in cls.__annotations__:
            setattr(cls, name, NamedNode(iri + name.rstrip("_")))

    @classmethod
    def terms(cls) -> dict[str, NamedNode]:
        """The terms of the namespace by local name."""
        return {name.rstrip("_"): getattr(cls, name) for name in cls.__annotations__}


class ros(Namespace, iri="https://w3id.org/rosld#"):
    """The ROS vocabulary."""

    # the computation graph
    Graph: NamedNode
    Master: NamedNode
    Node: NamedNode
    Topic: NamedNode
    Service: NamedNode
    Action: NamedNode
    Parameter: NamedNode
    Endpoint: NamedNode
    name: NamedNode
    master: NamedNode
    uri: NamedNode
    runId: NamedNode
    messageType: NamedNode
    serviceType: NamedNode
    actionType: NamedNode
    conflictingType: NamedNode
    publishes: NamedNode
    subscribes: NamedNode
    provides: NamedNode
    publisher: NamedNode
    subscriber: NamedNode
    provider: NamedNode
    endpoint: NamedNode
    node: NamedNode
    latched: NamedNode
    unreachable: NamedNode
    unreadable: NamedNode
    uncallable: NamedNode
    rate: NamedNode
    namespace: NamedNode
    value: NamedNode
    writable: NamedNode
    simulatedTime: NamedNode

    # messages and calls
    Message: NamedNode
    Call: NamedNode
    Goal: NamedNode
    Elided: NamedNode
    latest: NamedNode
    latestFrom: NamedNode
    received: NamedNode
    sequence: NamedNode
    dateTime: NamedNode
    service: NamedNode
    request: NamedNode
    response: NamedNode
    created: NamedNode
    answered: NamedNode
    words: NamedNode
    elided: NamedNode
    bytes: NamedNode
    requestShape: NamedNode
    responseShape: NamedNode
    shape: NamedNode

    # states
    State: NamedNode
    state: NamedNode
    staleSince: NamedNode
    reason: NamedNode
    Live: NamedNode
    Stale: NamedNode
    Running: NamedNode
    Succeeded: NamedNode
    Failed: NamedNode
    Refused: NamedNode
    Canceled: NamedNode
    OutcomeUnknown: NamedNode
    NotSent: NamedNode

    # types
    MessageType: NamedNode
    ServiceType: NamedNode
    ActionType: NamedNode
    Field: NamedNode
    Constant: NamedNode
    definition: NamedNode
    md5: NamedNode
    typeHash: NamedNode
    variant: NamedNode
    field: NamedNode
    fieldName: NamedNode
    fieldType: NamedNode
    position: NamedNode
    arrayLength: NamedNode
    arrayBound: NamedNode
    stringBound: NamedNode
    constant: NamedNode
    nestedType: NamedNode
    requestType: NamedNode
    responseType: NamedNode

    # recordings
    Bag: NamedNode
    BagTopic: NamedNode
    bag: NamedNode
    format: NamedNode
    start: NamedNode
    end: NamedNode
    count: NamedNode
    topic: NamedNode
    message: NamedNode
    index: NamedNode
    recordedAt: NamedNode

    # stored queries
    Query: NamedNode
    queryParameter: NamedNode
    timeLimit: NamedNode
    text: NamedNode

    # validation
    FieldConstraintComponent: NamedNode
    fieldPath: NamedNode

    # SPARQL functions
    Function: NamedNode
    at: NamedNode
    length: NamedNode
    min: NamedNode
    max: NamedNode
    mean: NamedNode
    age: NamedNode


class rdf(Namespace, iri="http://www.w3.org/1999/02/22-rdf-syntax-ns#"):
    """RDF 1.1."""

    type: NamedNode
    Property: NamedNode
    List: NamedNode
    first: NamedNode
    rest: NamedNode
    nil: NamedNode
    langString: NamedNode
    JSON: NamedNode


class rdfs(Namespace, iri="http://www.w3.org/2000/01/rdf-schema#"):
    """RDF Schema 1.1."""

    Class: NamedNode
    label: NamedNode
    comment: NamedNode
    domain: NamedNode
    range: NamedNode
    seeAlso: NamedNode
    isDefinedBy: NamedNode
    subClassOf: NamedNode
    subPropertyOf: NamedNode


class xsd(Namespace, iri="http://www.w3.org/2001/XMLSchema#"):
    """The XML Schema datatypes that ROS values have."""

    string: NamedNode
    boolean: NamedNode
    integer: NamedNode
    decimal: NamedNode
    float: NamedNode
    double: NamedNode
    byte: NamedNode
    short: NamedNode
    int: NamedNode
    long: NamedNode
    unsignedByte: NamedNode
    unsignedShort: NamedNode
    unsignedInt: NamedNode
    unsignedLong: NamedNode
    nonNegativeInteger: NamedNode
    dateTime: NamedNode
    base64Binary: NamedNode
    anyURI: NamedNode


class ldp(Namespace, iri="http://www.w3.org/ns/ldp#"):
    """Linked Data Platform 1.0."""

    Resource: NamedNode
    RDFSource: NamedNode
    NonRDFSource: NamedNode
    Container: NamedNode
    BasicContainer: NamedNode
    contains: NamedNode
    constrainedBy: NamedNode
    Page: NamedNode
    pageSequence: NamedNode


class xhv(Namespace, iri="http://www.w3.org/1999/xhtml/vocab#"):
    """Link relations as properties (XHTML vocabulary): the pages of a container."""

    first: NamedNode
    last: NamedNode
    next: NamedNode
    prev: NamedNode


class dcterms(Namespace, iri="http://purl.org/dc/terms/"):
    """Dublin Core."""

    title: NamedNode
    description: NamedNode


class foaf(Namespace, iri="http://xmlns.com/foaf/0.1/"):
    """FOAF: a document about a thing that is not itself a document."""

    primaryTopic: NamedNode


class sh(Namespace, iri="http://www.w3.org/ns/shacl#"):
    """SHACL."""

    NodeShape: NamedNode
    PropertyShape: NamedNode
    ValidationReport: NamedNode
    ValidationResult: NamedNode
    ConstraintComponent: NamedNode
    Violation: NamedNode
    BlankNodeOrIRI: NamedNode
    targetClass: NamedNode
    property: NamedNode
    path: NamedNode
    name: NamedNode
    description: NamedNode
    order: NamedNode
    datatype: NamedNode
    node: NamedNode
    nodeKind: NamedNode
    class_: NamedNode
    minCount: NamedNode
    maxCount: NamedNode
    minInclusive: NamedNode
    maxInclusive: NamedNode
    minLength: NamedNode
    maxLength: NamedNode
    pattern: NamedNode
    closed: NamedNode
    ignoredProperties: NamedNode
    or_: NamedNode
    zeroOrMorePath: NamedNode
    conforms: NamedNode
    result: NamedNode
    resultSeverity: NamedNode
    resultMessage: NamedNode
    resultPath: NamedNode
    focusNode: NamedNode
    value: NamedNode
    sourceConstraintComponent: NamedNode
    sourceShape: NamedNode


PREFIXES: Mapping[str, str] = {
    space.__name__: space.iri for space in (ros, rdf, rdfs, xsd, ldp, xhv, dcterms, foaf, sh)
} | {
    "owl": "http://www.w3.org/2002/07/owl#",
    "prov": "http://www.w3.org/ns/prov#",
    "sosa": "http://www.w3.org/ns/sosa/",
}
"""The prefixes under which people know these namespaces."""
