// node tests/tools/search.js build/docs: what the site's own search finds first, by the script that browsers run.
const fs = require("fs");
const vm = require("vm");

const FIRST = {
  "api/make_a_scene.html": ["gravity", "density"],
  "materials.html": ["friction", "rolling", "material", "filter", "sensor"],
  "moving.html": ["moving wall", "piston", "conveyor", "kinematic"],
  "recipes.html": ["callback", "video"],
  "forces.html": ["force", "energy"],
  "absent.html": ["GPU", "periodic", "3d", "polygon", "spring"],
  "gallery/other_programs.html": ["vtk", "pandas"],
};

const site = process.argv[2];
const workers = `${site}/assets/javascripts/workers`;
const name = fs.readdirSync(workers).find((file) => file.endsWith(".js"));
let handler, answered;
const scope = { console, setTimeout, URL, importScripts() {}, postMessage: (message) => answered(message) };
scope.self = scope;
scope.addEventListener = (kind, listener) => { handler = listener; };
vm.runInContext(fs.readFileSync(`${workers}/${name}`, "utf8"), vm.createContext(scope));

function ask(type, data) {
  return new Promise((resolve) => { answered = resolve; handler({ data: { type, data } }); });
}

(async () => {
  const { config, docs } = JSON.parse(fs.readFileSync(`${site}/search/search_index.json`, "utf8"));
  await ask(0, { config, docs, options: { suggest: false } });
  for (const [page, words] of Object.entries(FIRST)) {
    for (const word of words) {
      const [found] = (await ask(2, word)).data.items;
      const first = found ? found[0].location.split("#")[0] : "nothing";
      if (first !== page) {
        console.error(`search for ${word}: expected ${page} first, got ${first}`);
        process.exitCode = 1;
      }
    }
  }
})();
