"""The page's frame. `$name` is filled by page.py with HTML that is already escaped."""

from __future__ import annotations

from string import Template

PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
:root {
  color-scheme: light dark;
  --ink: #1c1f23; --soft: #5b6470; --page: #fbfbfa; --card: #ffffff; --edge: #dfe3e8;
  --good: #1a7f37; --bad: #b42318; --open: #8a6100;
}
@media (prefers-color-scheme: dark) {
  :root {
    --ink: #e7e9ec; --soft: #a3acb8; --page: #15181c; --card: #1d2126; --edge: #353b43;
    --good: #57c977; --bad: #ff8a80; --open: #e8b931;
  }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
main { max-width: 1060px; margin: 0 auto; padding: 24px 16px 48px; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 .4rem; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .7rem; }
p { margin: .4rem 0; max-width: 75ch; }
.soft, figcaption { color: var(--soft); }
.verdict { border-left: 6px solid var(--open); background: var(--card); padding: .7rem 1rem;
  margin: 1rem 0; font-size: 1.08rem; overflow-wrap: anywhere; max-width: none; }
.verdict b { color: var(--open); }
.verdict.good { border-color: var(--good); } .verdict.good b { color: var(--good); }
.verdict.bad { border-color: var(--bad); } .verdict.bad b { color: var(--bad); }
figure { margin: 0; }
figure img { width: 100%; height: auto; display: block; border-radius: 6px; }
figcaption { font-size: .88rem; margin: .35rem 0 0; }
.small, .plots { display: grid; gap: 14px; margin-top: 14px;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 300px), 1fr)); }
.plots { grid-template-columns: repeat(auto-fit, minmax(min(100%, 420px), 1fr));
  align-items: start; }
.plot { background: #ffffff; border: 1px solid var(--edge); border-radius: 6px; padding: 8px; }
.plot svg { width: 100%; height: auto; display: block; }
.legend { display: flex; flex-wrap: wrap; gap: .2rem 1.1rem; padding: 0; margin: .6rem 0;
  list-style: none; font-size: .9rem; }
.legend i { display: inline-block; width: .85em; height: .85em; border-radius: 50%;
  margin-right: .4em; vertical-align: -.05em; border: 1px solid var(--soft); }
.legend i.line { height: .3em; width: 1.5em; border-radius: 0; vertical-align: .2em; }
.legend i.dash { height: 0; width: 1.6em; border: 0; border-top: 3px dashed var(--soft);
  border-radius: 0; vertical-align: .2em; }
table { border-collapse: collapse; width: 100%; background: var(--card);
  border: 1px solid var(--edge); font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .45rem .7rem; border-bottom: 1px solid var(--edge);
  vertical-align: top; }
thead th { font-size: .88rem; color: var(--soft); font-weight: 600; }
tbody th { font-weight: 600; }
td.good { color: var(--good); } td.bad { color: var(--bad); }
dl { display: grid; grid-template-columns: minmax(8rem, max-content) 1fr; gap: .25rem 1rem;
  margin: 0; } dt { font-weight: 600; } dd { margin: 0; overflow-wrap: anywhere; }
pre { background: var(--card); border: 1px solid var(--edge); border-radius: 6px;
  padding: .7rem .9rem; white-space: pre-wrap; overflow-wrap: anywhere; font-size: .9rem; }
@media (max-width: 620px) {
  thead { display: none; }
  tr, tbody th, td { display: block; }
  tbody th, td { border: 0; padding: .1rem .7rem; }
  tbody th { padding-top: .5rem; }
  tr { border-bottom: 1px solid var(--edge); padding-bottom: .5rem; }
  td::before { content: attr(data-label) ": "; color: var(--soft); }
  dl { grid-template-columns: 1fr; gap: 0; } dd { margin-bottom: .4rem; }
}
</style>
</head>
<body>
<main>
<h1>$title</h1>
<p>$sentence</p>
<p class="verdict $verdict_class">$verdict</p>
$notes
<h2>What the camera saw</h2>
$pictures
<h2>Results</h2>
$results
$plots
$rounds
<h2>How to read this</h2>
$reading
<h2>How to reproduce</h2>
<pre>$command</pre>
<dl>$facts</dl>
</main>
</body>
</html>
""")
