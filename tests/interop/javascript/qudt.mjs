/* Writes QUDT's units and quantity kinds, as published by qudtlib, as one JSON object. */
import { config } from "@qudtlib/allunits";

const name = (iri) => iri.split("/").pop();
const units = [...config.units.values()].map((unit) => [name(unit.iri), {
  multiplier: unit.conversionMultiplier?.toString() ?? null,
  offset: unit.conversionOffset?.toString() ?? "0",
  dimension: unit.dimensionVectorIri ?? null,
  kinds: unit.quantityKindIris.map(name),
}]);
const kinds = [...config.quantityKinds.values()].map((kind) => [name(kind.iri), kind.applicableUnitIris.map(name)]);
process.stdout.write(JSON.stringify({ units: Object.fromEntries(units), kinds: Object.fromEntries(kinds) }));
