"""The terms rosld writes and reads, one class a namespace: `ros.publishes` is the NamedNode `ros:publishes`.

The terms of `ros:`, `map:` and `av:` are defined by the modules of the ontology, the Turtle beside this file; tests
hold each against its class here, both ways. A trailing underscore only keeps a term clear of a Python keyword:
`sh.or_` is `sh:or`.
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
    robot: NamedNode
    Master: NamedNode
    Node: NamedNode
    Topic: NamedNode
    Service: NamedNode
    Action: NamedNode
    Parameter: NamedNode
    ManagedNode: NamedNode
    Endpoint: NamedNode
    Publisher: NamedNode
    Subscriber: NamedNode
    Qos: NamedNode
    QosMismatch: NamedNode
    Property: NamedNode
    ComplexResource: NamedNode
    readsFrom: NamedNode
    writesTo: NamedNode
    invokes: NamedNode
    name: NamedNode
    hasMaster: NamedNode
    uri: NamedNode
    runId: NamedNode
    hasMessageType: NamedNode
    hasServiceType: NamedNode
    hasActionType: NamedNode
    conflictingType: NamedNode
    publishes: NamedNode
    subscribes: NamedNode
    provides: NamedNode
    sendsGoalsTo: NamedNode
    hasParameter: NamedNode
    lifecycleState: NamedNode
    lifecycleStateWord: NamedNode
    lifecycleUnknown: NamedNode
    transition: NamedNode
    uriTemplate: NamedNode
    targetState: NamedNode
    targetStateWord: NamedNode
    publishedBy: NamedNode
    subscribedBy: NamedNode
    provider: NamedNode
    client: NamedNode
    hasEndpoint: NamedNode
    isEndpointOf: NamedNode
    ofNode: NamedNode
    ofTopic: NamedNode
    latched: NamedNode
    hasQos: NamedNode
    reliability: NamedNode
    durability: NamedNode
    history: NamedNode
    depth: NamedNode
    deadline: NamedNode
    lifespan: NamedNode
    liveliness: NamedNode
    lease: NamedNode
    hasQosMismatch: NamedNode
    offeringNode: NamedNode
    requestingNode: NamedNode
    qosMismatchCount: NamedNode
    policy: NamedNode
    offered: NamedNode
    requested: NamedNode
    unreachable: NamedNode
    unreadable: NamedNode
    uncallable: NamedNode
    unusable: NamedNode
    mappingWarning: NamedNode
    rate: NamedNode
    briefValue: NamedNode
    namespace: NamedNode
    Moment: NamedNode
    momentOf: NamedNode
    momentTime: NamedNode
    newestRecord: NamedNode
    triggerCondition: NamedNode
    triggerCount: NamedNode
    triggerLimit: NamedNode
    triggerResource: NamedNode
    triggerShape: NamedNode
    value: NamedNode
    writable: NamedNode
    readOnly: NamedNode
    parameterType: NamedNode
    step: NamedNode
    simulatedTime: NamedNode

    # rights
    Command: NamedNode
    glob: NamedNode
    typeGlob: NamedNode
    deny: NamedNode
    tokenDigest: NamedNode

    # messages and calls
    Message: NamedNode
    Call: NamedNode
    Goal: NamedNode
    Elided: NamedNode
    elidedLength: NamedNode
    latest: NamedNode
    latestFrom: NamedNode
    past: NamedNode
    pastLimit: NamedNode
    received: NamedNode
    sequence: NamedNode
    sentBy: NamedNode
    dateTime: NamedNode
    isCallOf: NamedNode
    request: NamedNode
    response: NamedNode
    isGoalOf: NamedNode
    hasGoal: NamedNode
    goalId: NamedNode
    own: NamedNode
    status: NamedNode
    statusWord: NamedNode
    goalMessage: NamedNode
    feedback: NamedNode
    result: NamedNode
    words: NamedNode
    bytes: NamedNode
    requestShape: NamedNode
    responseShape: NamedNode
    goalShape: NamedNode
    resultShape: NamedNode
    feedbackShape: NamedNode
    shape: NamedNode

    # states
    OperationalState: NamedNode
    GraphState: NamedNode
    CallState: NamedNode
    GoalStatus: NamedNode
    ManagedNodeState: NamedNode
    PrimaryState: NamedNode
    TransitionState: NamedNode
    state: NamedNode
    staleSince: NamedNode
    reason: NamedNode
    Live: NamedNode
    Stale: NamedNode
    Running: NamedNode
    Succeeded: NamedNode
    Failed: NamedNode
    Refused: NamedNode
    Accepted: NamedNode
    Executing: NamedNode
    Canceling: NamedNode
    Canceled: NamedNode
    Aborted: NamedNode
    Rejected: NamedNode
    Lost: NamedNode
    OutcomeUnknown: NamedNode
    NotSent: NamedNode
    Unconfigured: NamedNode
    Inactive: NamedNode
    Active: NamedNode
    Finalized: NamedNode
    Configuring: NamedNode
    CleaningUp: NamedNode
    ShuttingDown: NamedNode
    Activating: NamedNode
    Deactivating: NamedNode
    ErrorProcessing: NamedNode

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
    hasField: NamedNode
    fieldName: NamedNode
    fieldType: NamedNode
    position: NamedNode
    arrayLength: NamedNode
    arrayBound: NamedNode
    stringBound: NamedNode
    hasConstant: NamedNode
    nestedType: NamedNode
    requestType: NamedNode
    responseType: NamedNode
    goalType: NamedNode
    resultType: NamedNode
    feedbackType: NamedNode

    # holds and the stop
    Hold: NamedNode
    heldBy: NamedNode
    holds: NamedNode
    heldMessage: NamedNode
    holder: NamedNode
    publishRate: NamedNode
    leaseTime: NamedNode
    leaseUntil: NamedNode
    holdTime: NamedNode
    then: NamedNode
    atTheEnd: NamedNode
    Stop: NamedNode
    hasStop: NamedNode
    stopped: NamedNode
    stoppedBy: NamedNode
    stoppedAt: NamedNode
    stopStep: NamedNode
    subscriberCount: NamedNode
    warning: NamedNode

    # recordings
    Bag: NamedNode
    BagTopic: NamedNode
    Record: NamedNode
    hasRecordedTopic: NamedNode
    recordedIn: NamedNode
    start: NamedNode
    end: NamedNode
    count: NamedNode
    onTopic: NamedNode
    recordedMessage: NamedNode
    dropped: NamedNode
    recordingProblem: NamedNode
    recordsTopic: NamedNode
    silentTopic: NamedNode
    Series: NamedNode
    SeriesPoint: NamedNode
    Plot: NamedNode
    plots: NamedNode
    seriesOf: NamedNode
    seriesField: NamedNode
    hasPoint: NamedNode
    pointTime: NamedNode
    pointValue: NamedNode
    minimum: NamedNode
    maximum: NamedNode
    meanValue: NamedNode
    secondsBefore: NamedNode
    secondsLong: NamedNode
    recordingStatus: NamedNode
    recordedBytes: NamedNode
    recordedFile: NamedNode
    index: NamedNode
    recordedAt: NamedNode
    opensRecording: NamedNode

    # cockpits
    Cockpit: NamedNode
    Panel: NamedNode
    PlotPanel: NamedNode
    PicturePanel: NamedNode
    SpacePanel: NamedNode
    ValuePanel: NamedNode
    DrivePanel: NamedNode
    ButtonPanel: NamedNode
    QueryPanel: NamedNode
    hasPanel: NamedNode
    shows: NamedNode
    gridColumn: NamedNode
    gridRow: NamedNode
    gridWidth: NamedNode
    gridHeight: NamedNode

    # stored queries
    Query: NamedNode
    queryParameter: NamedNode
    timeLimit: NamedNode
    memoryLimit: NamedNode
    rowLimit: NamedNode
    concurrencyLimit: NamedNode
    queueLimit: NamedNode
    text: NamedNode

    # the store beside it
    Mirror: NamedNode
    hasMirror: NamedNode
    store: NamedNode
    revision: NamedNode
    lag: NamedNode
    pending: NamedNode
    refusedGraphs: NamedNode

    # the server itself
    ServerStatus: NamedNode
    hasServerStatus: NamedNode
    longestPause: NamedNode
    longestPauseEnd: NamedNode
    longestPauseCode: NamedNode
    longestWork: NamedNode
    longestWorkCode: NamedNode
    recentPause: NamedNode
    storageProblem: NamedNode
    interruptedHold: NamedNode

    # receipts
    Write: NamedNode
    touches: NamedNode
    matched: NamedNode
    does: NamedNode
    duration: NamedNode
    byteLength: NamedNode
    digest: NamedNode
    excerpt: NamedNode
    withheld: NamedNode

    # validation
    FieldConstraintComponent: NamedNode
    StepConstraintComponent: NamedNode
    fieldPath: NamedNode

    # search
    matchedBy: NamedNode

    # SPARQL functions
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
    value: NamedNode
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


class owl(Namespace, iri="http://www.w3.org/2002/07/owl#"):
    """OWL 2."""

    Class: NamedNode
    DatatypeProperty: NamedNode
    ObjectProperty: NamedNode
    NamedIndividual: NamedNode
    Ontology: NamedNode


class sd(Namespace, iri="http://www.w3.org/ns/sparql-service-description#"):
    """SPARQL 1.1 Service Description."""

    Service: NamedNode
    Dataset: NamedNode
    Graph: NamedNode
    Function: NamedNode
    endpoint: NamedNode
    supportedLanguage: NamedNode
    SPARQL11Query: NamedNode
    SPARQL11Update: NamedNode
    inputFormat: NamedNode
    resultFormat: NamedNode
    feature: NamedNode
    UnionDefaultGraph: NamedNode
    defaultDataset: NamedNode
    defaultGraph: NamedNode
    defaultEntailmentRegime: NamedNode
    extensionFunction: NamedNode


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
    hexBinary: NamedNode
    anyURI: NamedNode


class ldp(Namespace, iri="http://www.w3.org/ns/ldp#"):
    """Linked Data Platform 1.0."""

    Resource: NamedNode
    RDFSource: NamedNode
    NonRDFSource: NamedNode
    Container: NamedNode
    BasicContainer: NamedNode
    DirectContainer: NamedNode
    IndirectContainer: NamedNode
    contains: NamedNode
    member: NamedNode
    MemberSubject: NamedNode
    membershipResource: NamedNode
    hasMemberRelation: NamedNode
    isMemberOfRelation: NamedNode
    insertedContentRelation: NamedNode
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
    isPartOf: NamedNode
    hasPart: NamedNode
    created: NamedNode
    modified: NamedNode
    format: NamedNode


class spdx(Namespace, iri="http://spdx.org/rdf/terms#"):
    """Checksums (SPDX 2.3), as DCAT has them."""

    Checksum: NamedNode
    checksum: NamedNode
    algorithm: NamedNode
    checksumValue: NamedNode
    checksumAlgorithm_sha256: NamedNode


class foaf(Namespace, iri="http://xmlns.com/foaf/0.1/"):
    """FOAF: a document about a thing that is not itself a document; agents."""

    primaryTopic: NamedNode
    Agent: NamedNode


class acl(Namespace, iri="http://www.w3.org/ns/auth/acl#"):
    """Web Access Control."""

    Authorization: NamedNode
    AuthenticatedAgent: NamedNode
    Read: NamedNode
    Write: NamedNode
    Control: NamedNode
    accessTo: NamedNode
    agent: NamedNode
    agentClass: NamedNode
    default_: NamedNode
    mode: NamedNode


class sh(Namespace, iri="http://www.w3.org/ns/shacl#"):
    """SHACL."""

    NodeShape: NamedNode
    PropertyShape: NamedNode
    ValidationReport: NamedNode
    ValidationResult: NamedNode
    ConstraintComponent: NamedNode
    Violation: NamedNode
    Warning: NamedNode
    Info: NamedNode
    IRI: NamedNode
    BlankNode: NamedNode
    Literal: NamedNode
    BlankNodeOrIRI: NamedNode
    BlankNodeOrLiteral: NamedNode
    IRIOrLiteral: NamedNode
    targetClass: NamedNode
    targetNode: NamedNode
    targetObjectsOf: NamedNode
    property: NamedNode
    path: NamedNode
    name: NamedNode
    description: NamedNode
    defaultValue: NamedNode
    order: NamedNode
    group: NamedNode
    datatype: NamedNode
    node: NamedNode
    nodeKind: NamedNode
    class_: NamedNode
    minCount: NamedNode
    maxCount: NamedNode
    minInclusive: NamedNode
    maxInclusive: NamedNode
    minExclusive: NamedNode
    maxExclusive: NamedNode
    lessThan: NamedNode
    lessThanOrEquals: NamedNode
    hasValue: NamedNode
    in_: NamedNode
    flags: NamedNode
    message: NamedNode
    severity: NamedNode
    deactivated: NamedNode
    minLength: NamedNode
    maxLength: NamedNode
    pattern: NamedNode
    closed: NamedNode
    ignoredProperties: NamedNode
    and_: NamedNode
    or_: NamedNode
    not_: NamedNode
    xone: NamedNode
    inversePath: NamedNode
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


class td(Namespace, iri="https://www.w3.org/2019/wot/td#"):
    """WoT Thing Description 1.1, as an ontology."""

    Thing: NamedNode
    PropertyAffordance: NamedNode
    ActionAffordance: NamedNode
    EventAffordance: NamedNode
    hasPropertyAffordance: NamedNode
    hasActionAffordance: NamedNode
    hasEventAffordance: NamedNode
    hasForm: NamedNode
    name: NamedNode
    isObservable: NamedNode
    readProperty: NamedNode
    writeProperty: NamedNode
    observeProperty: NamedNode
    invokeAction: NamedNode
    cancelAction: NamedNode
    subscribeEvent: NamedNode
    queryAction: NamedNode
    unobserveProperty: NamedNode
    readAllProperties: NamedNode
    hasUriTemplateSchema: NamedNode
    title: NamedNode
    description: NamedNode
    hasLink: NamedNode
    hasInputSchema: NamedNode
    hasOutputSchema: NamedNode
    hasSecurityConfiguration: NamedNode
    definesSecurityScheme: NamedNode
    hasInstanceConfiguration: NamedNode
    isSafe: NamedNode
    isIdempotent: NamedNode
    isSynchronous: NamedNode


class js(Namespace, iri="https://www.w3.org/2019/wot/json-schema#"):
    """JSON Schema in RDF (WoT)."""

    NumberSchema: NamedNode
    StringSchema: NamedNode
    properties: NamedNode
    propertyName: NamedNode
    default: NamedNode
    items: NamedNode
    exclusiveMinimum: NamedNode
    maximum: NamedNode


class hctl(Namespace, iri="https://www.w3.org/2019/wot/hypermedia#"):
    """Hypermedia controls (WoT)."""

    Form: NamedNode
    Link: NamedNode
    hasTarget: NamedNode
    hasOperationType: NamedNode
    hasRelationType: NamedNode
    forContentType: NamedNode
    forSubProtocol: NamedNode
    hintsAtMediaType: NamedNode


class wotsec(Namespace, iri="https://www.w3.org/2019/wot/security#"):
    """How things are secured (WoT)."""

    BasicSecurityScheme: NamedNode
    BearerSecurityScheme: NamedNode
    ComboSecurityScheme: NamedNode
    NoSecurityScheme: NamedNode


class sosa(Namespace, iri="http://www.w3.org/ns/sosa/"):
    """SOSA, 2023 edition: what observes and acts, and the platform that carries it."""

    Observation: NamedNode
    Platform: NamedNode
    hasResult: NamedNode
    hosts: NamedNode
    hasSimpleResult: NamedNode
    madeBySensor: NamedNode
    observedProperty: NamedNode
    resultTime: NamedNode


class tree(Namespace, iri="https://w3id.org/tree#"):
    """TREE: collections in pages that tell what is behind their links."""

    GreaterThanOrEqualToRelation: NamedNode
    LessThanOrEqualToRelation: NamedNode
    Node: NamedNode
    Relation: NamedNode
    member: NamedNode
    node: NamedNode
    path: NamedNode
    relation: NamedNode
    shape: NamedNode
    value: NamedNode
    view: NamedNode


class ldes(Namespace, iri="https://w3id.org/ldes#"):
    """Linked Data Event Streams."""

    EventStream: NamedNode
    timestampPath: NamedNode
    versionOfPath: NamedNode


class memento(Namespace, iri="http://mementoweb.org/ns#"):
    """Memento (RFC 7089): resources as they were."""

    Memento: NamedNode
    TimeMap: NamedNode
    memento: NamedNode
    mementoDatetime: NamedNode
    original: NamedNode
    timegate: NamedNode


class cora(Namespace, iri="http://purl.org/ieee1872-owl/cora-bare#"):
    """The Core Ontology for Robotics and Automation (IEEE 1872-2015)."""

    Robot: NamedNode


class htv(Namespace, iri="http://www.w3.org/2011/http#"):
    """HTTP in RDF."""

    Request: NamedNode
    Response: NamedNode
    methodName: NamedNode
    requestURI: NamedNode
    statusCodeValue: NamedNode


class prov(Namespace, iri="http://www.w3.org/ns/prov#"):
    """PROV-O: who did what, when, and with what."""

    Activity: NamedNode
    Agent: NamedNode
    Association: NamedNode
    Entity: NamedNode
    Plan: NamedNode
    agent: NamedNode
    endedAtTime: NamedNode
    generated: NamedNode
    hadPlan: NamedNode
    has_provenance: NamedNode
    qualifiedAssociation: NamedNode
    startedAtTime: NamedNode
    used: NamedNode
    wasAssociatedWith: NamedNode
    wasInformedBy: NamedNode


class schema_org(Namespace, iri="https://schema.org/"):
    """Schema.org: domains and ranges that leave room for others; lists in an order."""

    domainIncludes: NamedNode
    rangeIncludes: NamedNode
    ItemList: NamedNode
    ListItem: NamedNode
    itemListElement: NamedNode
    numberOfItems: NamedNode
    position: NamedNode
    item: NamedNode
    name: NamedNode


class hydra(Namespace, iri="http://www.w3.org/ns/hydra/core#"):
    """Hydra: templates of URLs."""

    IriTemplate: NamedNode
    IriTemplateMapping: NamedNode
    BasicRepresentation: NamedNode
    freetextQuery: NamedNode
    mapping: NamedNode
    property: NamedNode
    required: NamedNode
    search: NamedNode
    template: NamedNode
    variable: NamedNode
    variableRepresentation: NamedNode


class qudt(Namespace, iri="http://qudt.org/schema/qudt/"):
    """QUDT: units and kinds of quantity."""

    hasUnit: NamedNode
    hasQuantityKind: NamedNode


class mapping(Namespace, iri="https://w3id.org/rosld/mapping#"):
    """The vocabulary of mapping documents."""

    ComplexResource: NamedNode
    MappedProperty: NamedNode
    MappedAction: NamedNode
    MappedLink: NamedNode
    StopAction: NamedNode
    stop: NamedNode
    call: NamedNode
    publish: NamedNode
    content: NamedNode
    path: NamedNode
    property: NamedNode
    predicate: NamedNode
    member: NamedNode
    field: NamedNode
    action: NamedNode
    relation: NamedNode
    name: NamedNode
    service: NamedNode
    link: NamedNode
    target: NamedNode
    about: NamedNode
    writableWhen: NamedNode
    availableWhen: NamedNode
    atRestWhen: NamedNode
    existsWhen: NamedNode


class av(Namespace, iri="https://w3id.org/rosld/aircraft#"):
    """The relations of the paper's aircraft (Listing 3)."""

    power: NamedNode
    start: NamedNode
    stop: NamedNode
    engine: NamedNode
    aircraft: NamedNode
    speed: NamedNode
    direction: NamedNode


_SPACES = (
    ros,
    rdf,
    rdfs,
    owl,
    xsd,
    ldp,
    xhv,
    dcterms,
    foaf,
    acl,
    sh,
    spdx,
    sd,
    td,
    js,
    hctl,
    htv,
    prov,
    sosa,
    tree,
    ldes,
    memento,
    cora,
    qudt,
    hydra,
    av,
)

PREFIXES: Mapping[str, str] = {space.__name__: space.iri for space in _SPACES} | {
    "map": mapping.iri,
    "unit": "http://qudt.org/vocab/unit/",
    "quantitykind": "http://qudt.org/vocab/quantitykind/",
    "skos": "http://www.w3.org/2004/02/skos/core#",
    "schema": schema_org.iri,
    "vann": "http://purl.org/vocab/vann/",
}
"""The prefixes under which people know these namespaces."""
