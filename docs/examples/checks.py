from gonio import checks, models

report = checks.check_model(models.get("phong"))
for finding in report.findings:
    print(f"{finding.name}: claimed {finding.claimed}, holds {finding.holds}")
