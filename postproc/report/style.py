"""The style sheet of the HTML report."""

CSS = """
:root{--ink:#1c2430;--soft:#5b6776;--rule:#dde3ea;--page:#f4f6f8;--card:#fff;--before:#b4451f;--after:#0b6e99;
--moved:#5a6f2b;--force:#6b4e9b;--bad:#b3261e;--warn:#8a5a00;--good:#1f6f43}
@media(prefers-color-scheme:dark){:root{--ink:#e6eaf0;--soft:#9aa7b5;--rule:#323c48;--page:#12171d;--card:#1b222b;
--before:#f08a5d;--after:#5ab8e0;--moved:#a9c46c;--force:#b79be6;--bad:#ff8a80;--warn:#f2c14e;--good:#7ed6a2}}
*{box-sizing:border-box}
body{margin:0;background:var(--page);color:var(--ink);font:15px/1.5 system-ui,"Segoe UI",Roboto,"Helvetica Neue",
Arial,sans-serif}
main{max-width:1080px;margin:0 auto;padding:28px 20px 40px}
header p{margin:0;color:var(--soft)}
header .kind{text-transform:uppercase;letter-spacing:.08em;font-size:12px}
h1{margin:0;font-size:28px;line-height:1.2;overflow-wrap:anywhere}
h2{margin:0 0 10px;font-size:16px}
section,.tiles>div{background:var(--card);border:1px solid var(--rule);border-radius:8px}
section{padding:16px 20px;margin-top:16px}
section>p{margin:6px 0 0;color:var(--soft);font-size:13px}
.columns{display:grid;grid-template-columns:3fr 2fr;gap:16px}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(190px,1fr));gap:16px;margin:20px 0 0}
.tiles>div{padding:12px 20px}
.tiles dt{color:var(--soft);font-size:13px}
.tiles dd{margin:0;font-size:28px;font-variant-numeric:tabular-nums}
.tiles small{font-size:15px;color:var(--soft)}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
th,td{padding:5px 10px 5px 0;text-align:right;border-top:1px solid var(--rule);vertical-align:top}
thead th{border-top:0;color:var(--soft);font-weight:500;font-size:13px}
th:first-child{text-align:left;font-weight:500}
.issues td:last-child,.issues thead th:last-child{text-align:left;padding-left:14px;width:78%}
.error{color:var(--bad);font-weight:600}.warning{color:var(--warn);font-weight:600}.info{color:var(--soft)}
.joints table{max-width:640px}
.good{color:var(--good)}
svg{display:block;width:100%;height:auto}
svg text{font:12px system-ui,"Segoe UI",Roboto,Arial,sans-serif;fill:var(--soft)}
svg .title{fill:var(--ink);font-weight:600;font-size:13px}svg .note{fill:var(--ink)}
.grid{stroke:var(--rule);fill:none}.axis{stroke:var(--soft);stroke-width:2;fill:none}
.line{fill:none;stroke-width:1.5;stroke-linejoin:round;stroke-linecap:round}
.line.before{stroke:var(--before)}.line.after{stroke:var(--after)}
.line.moved{stroke:var(--moved)}.line.force{stroke:var(--force)}
.band.before{fill:var(--before)}.band.after{fill:var(--after)}.band.moved{fill:var(--moved)}.band.force{fill:var(--force)}
.mark{fill:var(--card);stroke:var(--ink);stroke-width:1.5}
.way{fill:none;stroke-width:1.6;stroke-linejoin:round;stroke-linecap:round}
.rapid{fill:none;stroke:var(--rule);stroke-width:1}
.c0{stroke:#440154;background:#440154}.c1{stroke:#46327e;background:#46327e}.c2{stroke:#365c8d;background:#365c8d}
.c3{stroke:#277f8e;background:#277f8e}.c4{stroke:#1fa187;background:#1fa187}.c5{stroke:#4ac16d;background:#4ac16d}
.c6{stroke:#a0da39;background:#a0da39}.c7{stroke:#f5d423;background:#f5d423}
.legend{display:flex;flex-wrap:wrap;gap:4px 16px;list-style:none;margin:8px 0 0;padding:0;font-size:13px;
color:var(--soft);font-variant-numeric:tabular-nums}
.legend i{display:inline-block;width:18px;height:10px;border-radius:2px;margin-right:6px}
footer{margin-top:20px;color:var(--soft);font-size:13px}
@media(max-width:760px){.columns{grid-template-columns:1fr}}
@media screen and (max-width:760px){section{overflow-x:auto}section>svg{min-width:680px}}
@media print{body{background:#fff}section,.tiles>div{break-inside:avoid}}
"""
