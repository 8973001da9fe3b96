// Builds tactile_loc/reports/assets/plotly.min.js, and beside it plotly.licences.txt with the licences of all its parts.
// It takes the versions of package.json: cd scripts/plotly && npm install && npm run build
import { build } from "esbuild";
import { glsl } from "esbuild-plugin-glsl";
import inlineCss from "esbuild-plugin-inline-css";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";

const OUT = new URL("../../tactile_loc/reports/assets/", import.meta.url).pathname;
const TRACES = ["bar", "barpolar", "box", "heatmap", "mesh3d", "scatter3d", "violin"]; // scatter is always included
const version = JSON.parse(readFileSync("node_modules/plotly.js/package.json", "utf8")).version;
const registered = TRACES.map((trace) => `require("plotly.js/lib/${trace}")`).join(", ");

// Plotly's own builds leave out the descriptions of attributes, too.
const DESCRIPTIONS = /^\s*description: (?:'.*'|\[[^\]]*\]\s*\.join\(.*\)),?$/gm;
const leaveOutDescriptions = {
  name: "leave-out-descriptions",
  setup: ({ onLoad }) => onLoad({ filter: /plotly\.js\/src\/.*\.js$/ }, ({ path }) => (
    { contents: readFileSync(path, "utf8").replace(DESCRIPTIONS, ""), loader: "js" })),
};

const { metafile } = await build({
  stdin: { contents: `const p = require("plotly.js/lib/core"); p.register([${registered}]); module.exports = p;`,
           resolveDir: "." },
  format: "iife", globalName: "Plotly", bundle: true, minify: true, charset: "ascii", target: "es2016",
  outfile: `${OUT}plotly.min.js`, legalComments: "eof", metafile: true,
  banner: { js: `/* plotly.js v${version}, MIT licence; see plotly.licences.txt */` },
  plugins: [inlineCss(), glsl({ minify: true }), leaveOutDescriptions],
  alias: { regl: "@plotly/regl", stream: "stream-browserify" },
  define: { global: "window", "define.amd": "false", "process.env.NODE_DEBUG": "false" },
});

const folders = new Set(Object.keys(metafile.inputs).map((path) => /.*node_modules\/(?:@[^/]+\/)?[^/]+/.exec(path)?.[0]));
const texts = [...folders].filter(Boolean).sort().map((folder) => {
  const about = JSON.parse(readFileSync(`${folder}/package.json`, "utf8"));
  const file = readdirSync(folder).find((name) => /^licen[cs]e/i.test(name));
  const text = file ? readFileSync(`${folder}/${file}`, "utf8") : `${about.license}, ${about.author?.name ?? about.author} (the package has no licence text)`;
  return `${about.name} ${about.version} (${about.license})\n\n${text.replace(/\r/g, "").trim()}\n`;
});
writeFileSync(`${OUT}plotly.licences.txt`, texts.join(`\n${"-".repeat(80)}\n\n`));
