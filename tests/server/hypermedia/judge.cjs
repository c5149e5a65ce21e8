// Judges JSON by JSON Schema (Ajv). In: [[schema, value], ...]; the schema "td" is the W3C's of Thing Descriptions.
// Out: for each pair the errors, as a list of sentences. The first argument is the folder of the packages.
const { createRequire } = require("node:module");
const { readFileSync } = require("node:fs");
const from = createRequire(process.argv[2] + "/");
const Ajv = from("ajv");
const ajv = new (Ajv.default ?? Ajv)({ strict: false, allErrors: true });
const formats = from("ajv-formats");
(formats.default ?? formats)(ajv);

const td = ajv.compile(from("wot-thing-description-types/schema/td-json-schema-validation.json"));
const known = new Map();

function judge(schema) {
  if (schema === "td") return td;
  const key = JSON.stringify(schema);
  if (!known.has(key)) known.set(key, ajv.compile(schema));
  return known.get(key);
}

const verdicts = JSON.parse(readFileSync(0, "utf8")).map(([schema, value]) => {
  const valid = judge(schema);
  return valid(value) ? [] : valid.errors.map((error) => `${error.instancePath} ${error.message}`);
});
process.stdout.write(JSON.stringify(verdicts));
