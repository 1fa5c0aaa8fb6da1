from pathlib import Path

import gonio
from gonio import formats
from gonio.reporting import gather, page, statement
from gonio.reporting.tables import fit_table

rows = ["30,0,0,0,0.31,0.003", "30,0,40,180,0.30,0.003", "60,0,20,180,0.32,0.003"]
Path("own.csv").write_text("\n".join(["theta_i,phi_i,theta_r,phi_r,brdf,u_brdf", *rows]) + "\n")
result = gonio.fit(formats.read("own.csv"), model="lambert")
result.save("own.json")

stated = statement(operator="A. Ampère", dates=["2026-03-31"], coverage="k=2")
Path("own.html").write_text(page(gather("own.json"), stated), encoding="utf-8")
print(fit_table(result, stated.coverage).latex())
