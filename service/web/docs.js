// The description of the API for a person, from openapi.json alone: nothing is fetched from elsewhere.

import { h, section, table } from "./dom.js";

const view = document.getElementById("view");

const example = (schema, content = {}) => content.example ?? schema?.examples?.[0] ?? schema?.example;

class Description {
  constructor(document) {
    this.document = document;
  }

  named(schema) {
    const name = schema?.$ref?.split("/").pop();
    return name ? this.document.components.schemas[name] : schema;
  }

  // A type in a few words, and the range that it may have.
  type(schema) {
    if (!schema) return "";
    if (schema.$ref) {
      const name = schema.$ref.split("/").pop();
      return h("a", { href: "#" + name }, name);
    }
    const alternatives = schema.anyOf || schema.oneOf;
    if (alternatives) return alternatives.flatMap((s, k) => (k ? [" or ", this.type(s)] : [this.type(s)]));
    if (schema.type === "array") return ["list of ", this.type(schema.items)];
    const range = [
      schema.enum && schema.enum.join(", "), schema.const !== undefined && String(schema.const),
      schema.minimum !== undefined && "≥ " + schema.minimum, schema.exclusiveMinimum !== undefined && "> " + schema.exclusiveMinimum,
      schema.maximum !== undefined && "≤ " + schema.maximum, schema.default !== undefined && schema.default !== null && "default " + JSON.stringify(schema.default),
    ].filter(Boolean);
    return [schema.type || "any", range.length ? ": " + range.join(", ") : ""].join("");
  }

  fields(schema) {
    const rows = Object.entries(schema.properties || {}).map(([name, field]) => [
      name + ((schema.required || []).includes(name) ? " *" : ""), this.type(field), field.description || "",
    ]);
    return rows.length ? table(["field", "type", ""], rows) : "";
  }

  content(title, part) {
    return Object.entries(part?.content || {}).map(([kind, content]) => {
      const shown = example(this.named(content.schema), content);
      return h("div", {}, h("p", {}, title, " ", h("code", {}, kind), " ", this.type(content.schema)),
        shown === undefined ? "" : h("pre", {}, typeof shown === "string" ? shown : JSON.stringify(shown, null, 2)));
    });
  }

  operation(path, method, found) {
    const parameters = (found.parameters || []).map((p) => [p.name + (p.required ? " *" : ""), p.in, this.type(p.schema), p.description || ""]);
    const good = Object.entries(found.responses).filter(([status]) => status < "300");
    const answers = Object.entries(found.responses).map(([status, r]) => [status, r.description || "", Object.keys(r.headers || {}).join(", ")]);
    return h("details", { id: found.operationId },
      h("summary", {}, h("code", {}, method.toUpperCase() + " " + path), " ", (found.description || found.summary || "").split("\n")[0]),
      parameters.length ? table(["parameter", "in", "type", ""], parameters) : "",
      this.content("Body", found.requestBody),
      good.map(([status, response]) => this.content("Answer " + status, response)),
      table(["status", "", "headers"], answers));
  }

  page() {
    const groups = new Map();
    for (const [path, operations] of Object.entries(this.document.paths)) {
      for (const [method, found] of Object.entries(operations)) {
        const name = (found.tags || ["other"])[0];
        groups.set(name, [...(groups.get(name) || []), this.operation(path, method, found)]);
      }
    }
    const shapes = Object.entries(this.document.components.schemas).map(([name, schema]) =>
      h("details", { id: name }, h("summary", {}, name, " ", (schema.description || "").split("\n")[0]), this.fields(schema)));
    return [h("p", {}, this.document.info.description), ...[...groups].map(([name, parts]) => section(name, parts)), section("Shapes", shapes)];
  }
}

function open() {
  const place = document.getElementById(location.hash.slice(1));
  if (place instanceof HTMLDetailsElement) {
    place.open = true;
    place.scrollIntoView();
  }
}

try {
  const answer = await fetch("openapi.json");
  if (!answer.ok) throw new Error("the service answered " + answer.status);
  view.replaceChildren(...new Description(await answer.json()).page());
  window.addEventListener("hashchange", open);
  open();
  document.documentElement.setAttribute("data-shown", "docs");
} catch (error) {
  const problem = document.getElementById("problem");
  problem.textContent = error.message;
  problem.hidden = false;
}
