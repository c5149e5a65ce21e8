"""Terms of the vocabularies that rosld reads and writes: `ros.publishes` is the NamedNode `ros:publishes`.

The terms of `ros:`, `map:` and `av:` are those that the Turtle files next to this module define. `vocab.pyi` lists all
terms for type checkers and editors; `python tests/ontology/vocab_stub.py` writes it. A trailing underscore avoids
Python keywords: `sh.or_` is `sh:or`.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable, Mapping
from importlib.resources import files

from pyoxigraph import NamedNode


class Namespace:
    """A closed namespace: its IRI, and its terms as attributes and by local name."""

    def __init__(self, iri: str, names: str | Iterable[str]) -> None:
        self.iri = iri
        names = names.split() if isinstance(names, str) else names
        self.terms = {name: NamedNode(iri + name) for name in names}
        vars(self).update({attribute(name): term for name, term in self.terms.items()})


def attribute(name: str) -> str:
    """Return the name of the attribute for a term."""
    return f"{name}_" if keyword.iskeyword(name) else name


def _defined(prefix: str) -> list[str]:
    """Return the local names that the Turtle files define: those of the subjects, which begin a line."""
    return list(dict.fromkeys(re.findall(rf"^{prefix}:(\w+)", _TURTLE, re.MULTILINE)))


_TURTLE = "\n".join(
    file.read_text("utf-8")
    for file in sorted(files("rosld.ontology").iterdir(), key=lambda file: file.name)
    if file.name.endswith(".ttl")
)

ros = Namespace("https://w3id.org/rosld#", _defined("ros"))
mapping = Namespace("https://w3id.org/rosld/mapping#", _defined("map"))
av = Namespace("https://w3id.org/rosld/aircraft#", _defined("av"))

# RDF 1.1.
rdf = Namespace(
    "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "type Property List first rest nil value langString JSON",
)
# RDF Schema 1.1.
rdfs = Namespace(
    "http://www.w3.org/2000/01/rdf-schema#",
    "Class label comment domain range seeAlso isDefinedBy subClassOf subPropertyOf",
)
# OWL 2.
owl = Namespace("http://www.w3.org/2002/07/owl#", "Class DatatypeProperty ObjectProperty NamedIndividual Ontology")
# SPARQL 1.1 Service Description.
sd = Namespace(
    "http://www.w3.org/ns/sparql-service-description#",
    "Service Dataset Graph Function Aggregate endpoint supportedLanguage SPARQL11Query SPARQL11Update inputFormat "
    "resultFormat feature UnionDefaultGraph defaultDataset defaultGraph defaultEntailmentRegime extensionFunction "
    "extensionAggregate",
)
# XML Schema datatypes of ROS values.
xsd = Namespace(
    "http://www.w3.org/2001/XMLSchema#",
    "string boolean integer decimal float double byte short int long unsignedByte unsignedShort unsignedInt "
    "unsignedLong nonNegativeInteger dateTime dateTimeStamp base64Binary hexBinary anyURI",
)
# Linked Data Platform 1.0.
ldp = Namespace(
    "http://www.w3.org/ns/ldp#",
    "Resource RDFSource NonRDFSource Container BasicContainer DirectContainer IndirectContainer contains member "
    "MemberSubject membershipResource hasMemberRelation isMemberOfRelation insertedContentRelation constrainedBy Page "
    "pageSequence",
)
# XHTML vocabulary, for the pages of a container.
xhv = Namespace("http://www.w3.org/1999/xhtml/vocab#", "first last next prev")
# Dublin Core.
dcterms = Namespace(
    "http://purl.org/dc/terms/",
    "title description isPartOf hasPart created modified issued format publisher source temporal PeriodOfTime",
)
# DCAT 3.
dcat = Namespace(
    "http://www.w3.org/ns/dcat#",
    "Catalog Dataset Distribution DataService accessURL byteSize dataset distribution downloadURL endpointURL endDate "
    "keyword mediaType servesDataset service startDate",
)
# VoID.
void = Namespace(
    "http://rdfs.org/ns/void#",
    "Dataset DatasetDescription dataDump exampleResource rootResource sparqlEndpoint uriSpace vocabulary",
)
# Checksums (SPDX 2.3), as DCAT has them.
spdx = Namespace("http://spdx.org/rdf/terms#", "Checksum checksum algorithm checksumValue checksumAlgorithm_sha256")
# FOAF, for documents about things and for agents.
foaf = Namespace("http://xmlns.com/foaf/0.1/", "primaryTopic name Agent")
# Web Access Control.
acl = Namespace(
    "http://www.w3.org/ns/auth/acl#",
    "Authorization AuthenticatedAgent Read Write Control accessTo agent agentClass default mode",
)
# SHACL.
sh = Namespace(
    "http://www.w3.org/ns/shacl#",
    "NodeShape PropertyShape ValidationReport ValidationResult ConstraintComponent Violation Warning Info IRI "
    "BlankNode Literal BlankNodeOrIRI BlankNodeOrLiteral IRIOrLiteral targetClass targetNode targetObjectsOf property "
    "path name description defaultValue order group datatype node nodeKind class minCount maxCount minInclusive "
    "maxInclusive minExclusive maxExclusive lessThan lessThanOrEquals hasValue in flags message severity deactivated "
    "minLength maxLength pattern closed ignoredProperties and or not xone inversePath zeroOrMorePath conforms "
    "result resultSeverity resultMessage resultPath focusNode value sourceConstraintComponent sourceShape",
)
# WoT Thing Description 1.1, as an ontology.
td = Namespace(
    "https://www.w3.org/2019/wot/td#",
    "Thing PropertyAffordance ActionAffordance EventAffordance hasPropertyAffordance hasActionAffordance "
    "hasEventAffordance hasForm name isObservable readProperty writeProperty observeProperty invokeAction "
    "cancelAction subscribeEvent queryAction unobserveProperty readAllProperties hasUriTemplateSchema title "
    "description hasLink hasInputSchema hasOutputSchema hasSecurityConfiguration definesSecurityScheme "
    "hasInstanceConfiguration isSafe isIdempotent isSynchronous",
)
# JSON Schema in RDF (WoT).
js = Namespace(
    "https://www.w3.org/2019/wot/json-schema#",
    "NumberSchema StringSchema properties propertyName default items exclusiveMinimum maximum",
)
# Hypermedia controls (WoT).
hctl = Namespace(
    "https://www.w3.org/2019/wot/hypermedia#",
    "Form Link hasTarget hasOperationType hasRelationType forContentType forSubProtocol hintsAtMediaType",
)
# Security schemes (WoT).
wotsec = Namespace(
    "https://www.w3.org/2019/wot/security#",
    "BasicSecurityScheme BearerSecurityScheme ComboSecurityScheme NoSecurityScheme",
)
# SOSA, 2023 edition.
sosa = Namespace(
    "http://www.w3.org/ns/sosa/",
    "Actuation Actuator FeatureOfInterest Observation ObservationCollection Platform Sensor actsOnProperty "
    "hasFeatureOfInterest hasResult hasSimpleResult hosts isHostedBy madeByActuator madeBySensor observedProperty "
    "observes phenomenonTime resultQuality resultTime",
)
# OWL-Time.
owl_time = Namespace("http://www.w3.org/2006/time#", "Instant inXSDDateTimeStamp")
# TREE, for collections in pages.
tree = Namespace(
    "https://w3id.org/tree#",
    "GreaterThanOrEqualToRelation LessThanOrEqualToRelation Node Relation member node path relation shape value view",
)
# Linked Data Event Streams.
ldes = Namespace("https://w3id.org/ldes#", "EventStream timestampPath versionOfPath")
# Memento (RFC 7089).
memento = Namespace("http://mementoweb.org/ns#", "Memento TimeMap memento mementoDatetime original timegate")
# The Core Ontology for Robotics and Automation (IEEE 1872-2015).
cora = Namespace("http://purl.org/ieee1872-owl/cora-bare#", "Robot robotPart")
rparts = Namespace("http://purl.org/ieee1872-owl/rparts#", "robotSensingPart")
# HTTP in RDF.
htv = Namespace("http://www.w3.org/2011/http#", "Request Response methodName requestURI statusCodeValue")
# PROV-O.
prov = Namespace(
    "http://www.w3.org/ns/prov#",
    "Activity Agent Association Entity Plan SoftwareAgent agent endedAtTime generated hadPlan has_provenance "
    "qualifiedAssociation startedAtTime used wasAssociatedWith wasAttributedTo wasInformedBy",
)
# Schema.org, for open domains and ranges and for ordered lists.
schema_org = Namespace(
    "https://schema.org/",
    "domainIncludes rangeIncludes ItemList ListItem itemListElement numberOfItems position item name about "
    "description keywords",
)
# Hydra, for URL templates.
hydra = Namespace(
    "http://www.w3.org/ns/hydra/core#",
    "IriTemplate IriTemplateMapping BasicRepresentation freetextQuery mapping property required search template "
    "variable variableRepresentation",
)
# GeoSPARQL 1.1, and its classes of Simple Features.
geo = Namespace("http://www.opengis.net/ont/geosparql#", "Geometry hasGeometry asWKT wktLiteral")
sf = Namespace("http://www.opengis.net/ont/sf#", "LineString Point Polygon")
# QUDT, for units and kinds of quantity.
qudt = Namespace("http://qudt.org/schema/qudt/", "QuantityValue hasUnit hasQuantityKind numericValue")
# Data Quality Vocabulary.
dqv = Namespace("http://www.w3.org/ns/dqv#", "QualityMeasurement value")
# Solid Notifications.
notify = Namespace(
    "http://www.w3.org/ns/solid/notifications#",
    "subscription channelType feature topic receiveFrom accept endAt rate startAt state WebSocketChannel2023 "
    "StreamingHTTPChannel2023",
)
# Activity Streams 2.0.
activity = Namespace(
    "https://www.w3.org/ns/activitystreams#",
    "Create Update Delete Add Remove object target published",
)

_PREFIXES = {"mapping": "map", "schema_org": "schema", "activity": "as", "owl_time": "owl-time"}
PREFIXES: Mapping[str, str] = {
    **{_PREFIXES.get(name, name): each.iri for name, each in list(globals().items()) if isinstance(each, Namespace)},
    "math": "http://www.w3.org/2005/xpath-functions/math#",
    "geof": "http://www.opengis.net/def/function/geosparql/",
    "uom": "http://www.opengis.net/def/uom/OGC/1.0/",
    "unit": "http://qudt.org/vocab/unit/",
    "quantitykind": "http://qudt.org/vocab/quantitykind/",
    "skos": "http://www.w3.org/2004/02/skos/core#",
    "vann": "http://purl.org/vocab/vann/",
}
"""The usual prefixes of these namespaces."""
NAMESPACES: Mapping[str, str] = {iri: prefix for prefix, iri in PREFIXES.items()}
"""The prefixes by their namespaces."""
