// Bundles the page into ssduck/view/page, with the licences of what is in it and a hash of its sources.
import { createHash } from "node:crypto";
import { copyFileSync, existsSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const out = join(here, "..", "ssduck", "view", "page");
const names = ["build.mjs", "package-lock.json", "package.json", ...readdirSync(join(here, "src")).sort().map((name) => `src/${name}`)];

const result = await build({
  absWorkingDir: here,
  entryPoints: { page: "src/main.js" },
  outdir: out,
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2020",
  legalComments: "none",
  metafile: true,
});
await build({ absWorkingDir: here, entryPoints: { page: "src/page.css" }, outdir: out, minify: true });
copyFileSync(join(here, "src", "index.html"), join(out, "index.html"));

const packages = new Set();
for (const input of Object.keys(result.metafile.inputs)) {
  const match = input.match(/node_modules\/((?:@[^/]+\/)?[^/]+)\//);
  if (match) packages.add(match[1]);
}
const notices = [...packages].sort().map((name) => {
  const folder = join(here, "node_modules", name);
  const { version, license } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  const file = ["LICENSE", "LICENSE.md", "license"].map((each) => join(folder, each)).find(existsSync);
  return `${name} ${version}, ${license}\n\n${readFileSync(file, "utf8").trim()}\n`;
});
writeFileSync(join(out, "NOTICES.txt"), notices.join(`\n${"-".repeat(72)}\n\n`));

const hash = createHash("sha256");
for (const name of names) hash.update(`${name}\n`).update(readFileSync(join(here, name)));
writeFileSync(join(out, "sources.sha256"), `${hash.digest("hex")}\n`);
