"""Describing: pure functions from plain ROS values to documents, one a kind of resource. All IRIs are in full."""

from rosld.ontology.describe_activities import Receipt, activity_document
from rosld.ontology.describe_bags import bag_document, bag_message_document, bag_messages_document
from rosld.ontology.describe_containers import container_document, namespace_document, type_container_document
from rosld.ontology.describe_graph import SECTIONS, NodeView, entry_document, node_document, node_views
from rosld.ontology.describe_services import CallView, call_document, service_document
from rosld.ontology.describe_topics import topic_document
from rosld.ontology.describe_types import type_document
from rosld.ontology.namespaces import Members, is_namespace, members_of
from rosld.ontology.parameters import parameter_container_document, parameter_document

__all__ = [
    "SECTIONS",
    "CallView",
    "Members",
    "NodeView",
    "Receipt",
    "activity_document",
    "bag_document",
    "bag_message_document",
    "bag_messages_document",
    "call_document",
    "container_document",
    "entry_document",
    "is_namespace",
    "members_of",
    "namespace_document",
    "node_document",
    "node_views",
    "parameter_container_document",
    "parameter_document",
    "service_document",
    "topic_document",
    "type_container_document",
    "type_document",
]
